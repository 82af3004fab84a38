defmodule Aerie.Console.Commands.EntryTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Console.Commands.{Entry, Wording}

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
    assert %{state: :pending, tone: :busy, label: "Pending", share: nil, cancel: true} = Entry.of(@entry)

    assert %{state: :progress, label: "Under way", share: 46, text: "Place vehicle level"} =
             Entry.of(%{@entry | progress: %{"progress" => 0.456, "text" => "Place vehicle level"}})

    assert %{share: nil} = Entry.of(%{@entry | progress: %{"progress" => nil, "text" => nil}})
    assert %{cancel: false} = Entry.of(%{@entry | type: "arm"})
  end

  test "each result has words of its own; not knowing looks like no other" do
    shown =
      for {status, _meaning, _maybe} <- Result.table(),
          do: Entry.of(%{@entry | result: Result.new("a", status), done_at: 2})

    assert shown |> Enum.map(& &1.label) |> Enum.uniq() |> length() == length(Result.table())
    assert [:timeout, :unknown] == for(%{tone: :unsure, state: state} <- shown, do: state)
    assert %{text: "The vehicle may have done it."} = Enum.find(shown, &(&1.state == :unknown))

    assert %{text: "not so high", cancel: false} =
             Entry.of(%{@entry | result: Result.new("a", :denied, "not so high")})
  end

  test "a transfer is shown too, and can be cancelled" do
    upload = %{@entry | type: "mission_upload", params: %{count: 3, kind: :mission, odd: %{a: 1}}}

    assert %{title: "Mission upload", cancel: true, params: "count 3, kind mission, odd %{a: 1}"} =
             Entry.of(upload)
  end

  test "parameters as an operator would say them" do
    for {type, params, words} <- [
          {"goto", %{lat: 47.398331, lon: 8.5443, altitude: 10.0, altitude_reference: "home"},
           "47.39833, 8.54430 at 10 m above home"},
          {"goto", %{lat: 47.0, lon: 8.0, altitude: 500, altitude_reference: "msl", speed: 5.0},
           "47.00000, 8.00000 at 500 m above mean sea level, speed 5"},
          {"set_mode", %{mode: "AUTO_LOITER", setpoints_elsewhere: false}, "AUTO_LOITER"},
          {"takeoff", %{altitude: 10.0}, "10 m above home"},
          {"set_geofence", %{enabled: false}, "off"},
          {"calibrate", %{sensor: "compass_motor"}, "compass motor"},
          {"plan", %{action: "upload", items: 5, digest: String.duplicate("a", 64)}, "upload, items 5"},
          {"rc_override", %{channels: [1500, 0]}, "channels 1500 0"},
          {"hold", %{}, ""}
        ],
        do: assert({type, Wording.params(type, params)} == {type, words})
  end

  test "a refusal because another one is in charge names the form of these pages" do
    lease = %Aerie.Control.Policy.ControlLease{holder: "ann", via: "console", since: 1_795_000_000_000_000}

    assert {:deny, :lease, reason} =
             Aerie.Control.Policy.Rules.Lease.check(
               %{lease: %{required: false}},
               %{control: nil, ends_flight?: false, permission: :fly},
               %{lease: lease, source: %{name: "bob", role: :operator}}
             )

    assert %{text: text} = Entry.of(%{@entry | result: Result.new("a", :denied, reason), done_at: 2})
    assert text =~ ~r/\Aann is in charge of the vehicle .* UTC\); take over under “in charge”\z/
  end
end
