defmodule Aerie.Vehicle.FieldsTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Client.StateForm
  alias Aerie.Fleet.Replay
  alias Aerie.Vehicle.{Event, Fields, State}

  @page Path.expand("../../../../../docs/telemetry.md", __DIR__)

  test "docs/telemetry.md is up to date (mix aerie.telemetry)" do
    assert File.read!(@page) == Fields.Page.markdown()
  end

  @tag :tmp_dir
  test "mix aerie.telemetry writes it", %{tmp_dir: dir} do
    file = Path.join(dir, "telemetry.md")
    ExUnit.CaptureIO.capture_io(fn -> Mix.Tasks.Aerie.Telemetry.run([file]) end)
    assert File.read!(file) == Fields.Page.markdown()
  end

  @units ["°", "°/s", "°C", "m", "m/s", "m/s²", "V", "A", "mAh", "0..1", "1/s", "B/s", "µs", "s", "ms", nil]

  test "every group of the state is in the table; there are few units, and per cent is not one" do
    for {group, keys} <- State.Groups.keys(), do: assert(State.keys(group) == keys)

    for {_group, _title, fields} <- Fields.all(), field <- fields do
      assert field.meaning != "" and field.source != ""
      assert field.unit in @units
    end

    for %{fields: fields} <- Event.Types.all(), field <- fields, do: assert(field.unit in @units)
  end

  test "numbers are rounded to their decimals, in groups, lists and nested fields" do
    assert Fields.rounded(:position, %{heading: 90.2170000000073, lat: 47.39774189999998, alt_rel: nil}) ==
             %{heading: 90.22, lat: 47.3977419, alt_rel: nil}

    assert Fields.rounded("battery", %{
             remaining: 0.5700000000000001,
             batteries: [%{id: 0, voltage: 12.599999}]
           }) ==
             %{remaining: 0.57, batteries: [%{id: 0, voltage: 12.6}]}

    assert Fields.rounded(:health, %{ekf: %{flags: 831, velocity: 0.01234567}, vibration: [1.23456, nil]}) ==
             %{ekf: %{flags: 831, velocity: 0.012}, vibration: [1.23, nil]}

    # A mean of whole numbers is a whole number, and so are those beside it.
    assert Fields.rounded(:gps, %{satellites: 9.6, min: %{hdop: 0.7000001}, samples: 5}) ==
             %{satellites: 10, min: %{hdop: 0.7}, samples: 5}

    assert Fields.rounded(:mode, %{mode: "AUTO", armed: true}) == %{mode: "AUTO", armed: true}
    assert Fields.rounded("of the future", %{x: 0.1 + 0.2}) == %{x: 0.1 + 0.2}

    assert Fields.event(%{
             "remaining" => 0.3600000143051147,
             "duration" => 1.23456,
             "to" => 0.135000005,
             "position" => %{"lat" => 47.12345678901, "alt_rel" => 9.9999999}
           }) == %{
             "remaining" => 0.36,
             "duration" => 1.23,
             "to" => 0.135000005,
             "position" => %{"lat" => 47.1234568, "alt_rel" => 10.0}
           }
  end

  test "any number that a vehicle may send can be rounded, and stays within half of the last decimal" do
    property =
      :proper.forall(:proper_types.float(), fn x ->
        %{alt_rel: rounded} = Fields.rounded(:position, %{alt_rel: x})
        abs(rounded - x) <= max(0.005000001, abs(x) * 1.0e-15)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())

    for x <- [1.7e308, -1.7e308, 5.0e-324, -0.0],
        do: assert(is_float(Fields.rounded(:position, %{lat: x}).lat))
  end

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
      %{id: "V", network: "main", system_id: 1, status: :online, last_heard: 1, autopilot: :px4}
      |> Map.merge(%{vehicle_type: "copter", links: [], groups: %{battery: group}})
      |> StateForm.of(%{}, 1)
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
