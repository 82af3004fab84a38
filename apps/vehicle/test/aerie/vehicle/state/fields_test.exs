defmodule Aerie.Vehicle.State.FieldsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.{Event, Snapshot, State}
  alias Aerie.Vehicle.State.Fields
  alias Aerie.Vehicle.Snapshot.Page

  @root Path.expand("../../../../../..", __DIR__)

  test "docs/telemetry.md is what the code declares: mix aerie.telemetry" do
    assert File.read!(Path.join(@root, "docs/telemetry.md")) == Page.markdown()
  end

  test "every group, event and field of a vehicle and a link is on the page, with a meaning" do
    page = Page.markdown()

    for {group, _title, fields} <- Fields.all(), field <- fields do
      assert page =~ "#{group}"
      assert field.meaning != ""
    end

    for %{name: name} <- Event.Types.all(), do: assert(page =~ name)

    for {name, _unit, meaning} <- Object.rows(Snapshot.Fields.of(:whole) ++ MavRouter.Link.fields()) do
      assert page =~ "`#{name}`"
      assert meaning != ""
    end
  end

  @tag :tmp_dir
  test "mix aerie.telemetry writes it", %{tmp_dir: dir} do
    file = Path.join(dir, "telemetry.md")
    ExUnit.CaptureIO.capture_io(fn -> Mix.Tasks.Aerie.Telemetry.run([file]) end)
    assert File.read!(file) == Page.markdown()
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
    assert Fields.plain(:position, %{heading: 90.2170000000073, lat: 47.39774189999998, alt_rel: nil}) ==
             %{heading: 90.22, lat: 47.3977419, alt_rel: nil}

    assert Fields.plain("battery", %{
             remaining: 0.5700000000000001,
             batteries: [%{id: 0, voltage: 12.599999}]
           }) ==
             %{remaining: 0.57, batteries: [%{id: 0, voltage: 12.6}]}

    assert Fields.plain(:health, %{ekf: %{flags: 831, velocity: 0.01234567}, vibration: [1.23456, nil]}) ==
             %{ekf: %{flags: 831, velocity: 0.012}, vibration: [1.23, nil]}

    # A mean of whole numbers is a whole number, and so are those beside it.
    assert Fields.plain(:gps, %{satellites: 9.6, min: %{hdop: 0.7000001}, samples: 5}) ==
             %{satellites: 10, min: %{hdop: 0.7}, samples: 5}

    assert Fields.plain(:mode, %{mode: "AUTO", armed: true}) == %{mode: "AUTO", armed: true}
    assert Fields.plain("of the future", %{x: 0.1 + 0.2}) == %{x: 0.1 + 0.2}

    assert %{"lat" => 47.3977418} = Fields.plain("position", %{"lat" => 47.39774182})

    data = %{
      "remaining" => 0.3600000143051147,
      "duration" => 1.23456,
      "to" => 0.135000005,
      "position" => %{"lat" => 47.12345678901, "alt_rel" => 9.9999999}
    }

    event = Event.new("VID-001", "armed", 1, 1_000_000, 5, data)

    assert %{
             "epoch" => 3,
             "time" => "1970-01-01T00:00:01.000Z",
             "time_boot_ms" => 5,
             "data" => %{
               "remaining" => 0.36,
               "duration" => 1.23,
               "to" => 0.135000005,
               "position" => %{"lat" => 47.1234568, "alt_rel" => 10.0}
             }
           } = Fields.event(event, 3)

    refute is_map_key(Fields.event(event, nil), "epoch")
  end

  test "any number that a vehicle may send can be rounded, and stays within half of the last decimal" do
    property =
      :proper.forall(:proper_types.float(), fn x ->
        %{alt_rel: rounded} = Fields.plain(:position, %{alt_rel: x})
        abs(rounded - x) <= max(0.005000001, abs(x) * 1.0e-15)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())

    for x <- [1.7e308, -1.7e308, 5.0e-324, -0.0],
        do: assert(is_float(Fields.plain(:position, %{lat: x}).lat))
  end
end
