defmodule FleetWeb.Console.Commands.LifeTest do
  use ExUnit.Case, async: true

  alias Aerie.Command.Result
  alias FleetWeb.Console.Commands.Life

  @entry %{
    id: "a",
    vehicle: "VID-001",
    type: "calibrate",
    params: %{},
    source: "ann",
    via: "console",
    at: 1,
    progress: nil,
    result: nil,
    done_at: nil
  }

  test "pending, under way with share and prompt" do
    assert %{state: :pending, tone: :busy, label: "Pending", share: nil, cancel: true} = Life.of(@entry)

    assert %{state: :progress, label: "Under way", share: 46, text: "Place vehicle level"} =
             Life.of(%{@entry | progress: %{"progress" => 0.456, "text" => "Place vehicle level"}})

    assert %{share: nil} = Life.of(%{@entry | progress: %{"progress" => nil, "text" => nil}})
    assert %{cancel: false} = Life.of(%{@entry | type: "arm"})
  end

  test "each result has words of its own; not knowing looks like no other" do
    shown =
      for {status, _meaning, _maybe} <- Result.table(),
          do: Life.of(%{@entry | result: Result.new("a", status), done_at: 2})

    assert shown |> Enum.map(& &1.label) |> Enum.uniq() |> length() == length(Result.table())
    assert [:timeout, :unknown] == for(%{tone: :unsure, state: state} <- shown, do: state)
    assert %{text: "the vehicle may have done it"} = Enum.find(shown, &(&1.state == :unknown))

    assert %{text: "not so high", cancel: false} =
             Life.of(%{@entry | result: Result.new("a", :denied, "not so high")})
  end

  test "a transfer is shown too, and can be cancelled" do
    upload = %{@entry | type: "mission_upload", params: %{count: 3, kind: :mission, odd: %{a: 1}}}

    assert %{title: "Mission upload", cancel: true, params: "count 3, kind mission, odd %{a: 1}"} =
             Life.of(upload)
  end

  test "parameters in one line" do
    assert "altitude 20, altitude reference home, lat 47.1234568" ==
             Life.params(%{lat: 47.12345678, altitude: 20.0, altitude_reference: "home"})

    assert "channels 1500 0" == Life.params(%{channels: [1500, 0]})
  end
end
