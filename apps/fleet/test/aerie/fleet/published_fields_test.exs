defmodule Aerie.Fleet.PublishedFieldsTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Fleet.Replay
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.State.Fields

  test "everything that a recorded flight publishes is in the table: names, and decimals of every number" do
    {:ok, seen, _summary} = Replay.reduce(flight("arducopter_flight"), [], %{}, &published/2)
    {:ok, seen, _summary} = Replay.reduce(flight("px4_flight"), [], seen, &published/2)
    assert map_size(seen) > 40

    for {{group, name}, value} <- seen do
      assert {group, name, name in ["samples" | names(group)]} == {group, name, true}

      if is_float(value),
        do: assert({group, name, value, Float.round(value, 7)} == {group, name, value, value})
    end
  end

  test "NATS and state.sock have the same name for a value" do
    data = %{remaining: 0.9800000190734863, voltage: 22.799999237060547, current: nil}
    group = %{at: 1, time_boot_ms: 5, data: data}
    nats = JSON.decode!(Message.state("V", "battery", data, 5, 1))["data"]

    socket =
      %Snapshot{id: "V", groups: %{battery: group}}
      |> Snapshot.Fields.show(:short, %{now: 1, links: %{}})
      |> JSON.encode!()
      |> JSON.decode!()

    assert nats == %{"remaining" => 0.98, "voltage" => 22.8, "current" => nil}
    assert socket["battery"] == nats

    for {part, %{} = object} <- socket, part != "ages", name <- Map.keys(object) do
      assert {part, name, name in names(part)} == {part, name, true}
    end

    event = Event.new("V", "armed", 1, 1_700_000_000_000_000, 99, %{})
    assert %{"time_boot_ms" => 99} = JSON.decode!(Message.event(event))
  end

  defp names(group) do
    for {known, _title, fields} <- Fields.all(),
        to_string(known) == group,
        %{path: path} <- fields,
        do: to_string(List.last(path))
  end

  defp published({:sample, sample}, seen) do
    body = Message.state(sample.vehicle, to_string(sample.group), sample.data, sample.time_boot_ms, sample.at)
    %{"group" => group, "data" => data} = JSON.decode!(body)
    leaves(group, data, seen)
  end

  defp published(_other, seen), do: seen

  # PX4's checks are named by PX4.
  defp leaves(_group, %{"arming_checks" => _} = data, seen) when map_size(data) == 1, do: seen

  defp leaves(group, data, seen) do
    Enum.reduce(data, seen, fn
      {name, %{} = below}, seen when name in ["min", "max", "ekf"] -> leaves(group, below, seen)
      {"batteries", list}, seen when is_list(list) -> Enum.reduce(list, seen, &leaves(group, &1, &2))
      {name, list}, seen when is_list(list) -> Enum.reduce(list, seen, &Map.put(&2, {group, name}, &1))
      {name, value}, seen -> Map.put(seen, {group, name}, value)
    end)
  end

  defp flight(name), do: Path.expand("../../../../vehicle/test/fixtures/#{name}.tlog.gz", __DIR__)
end
