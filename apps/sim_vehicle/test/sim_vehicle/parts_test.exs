defmodule SimVehicle.PartsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M

  alias SimVehicle.{Fleet, Link, Params, Pilot, Real32, Vehicle}
  alias SimVehicle.Physics.Battery
  alias SimVehicle.Server.{Options, Simulation}
  alias SimVehicle.Services.{Streams, Texts}
  alias SimVehicle.Vehicle.Camera

  describe "streams" do
    test "send at their rate, whatever the step" do
      for step <- [20_000, 40_000, 50_000] do
        {count, _streams} =
          Enum.reduce(1..div(10_000_000, step), {0, Streams.new(%{30 => 10, 33 => 4})}, fn n,
                                                                                           {count, streams} ->
            {ids, streams} = Streams.due(streams, n * step)
            {count + Enum.count(ids, &(&1 == 30)), streams}
          end)

        assert_in_delta count, 100, 2
      end
    end

    test "0 is the default, -1 stops; the interval is reported (M1)" do
      streams = Streams.new(%{30 => 10})
      assert Streams.interval_us(streams, 30) == 100_000
      assert streams |> Streams.set(30, 5000) |> Streams.interval_us(30) == 5000
      assert streams |> Streams.set(30, 5000) |> Streams.set(30, 0) |> Streams.interval_us(30) == 100_000
      assert streams |> Streams.set(30, -1) |> Streams.interval_us(30) == -1
      assert streams |> Streams.set(33, 1000) |> Streams.set(33, 0) |> Streams.interval_us(33) == -1
    end

    test "missed messages are not sent after a pause" do
      {_ids, streams} = Streams.due(Streams.new(%{30 => 10}), 0)
      {_ids, streams} = Streams.due(streams, 60_000_000)
      assert {[], _streams} = Streams.due(streams, 60_050_000)
    end
  end

  describe "the camera" do
    test "sends its own heartbeats and lists its parameters, whichever the firmware" do
      for firmware <- [:ardupilot, :px4] do
        options = Options.validate!(firmware: firmware, camera: 100)
        {vehicle, _boot} = options |> Vehicle.new() |> Simulation.boot(1_795_213_318_360_000)
        {vehicle, actions} = Simulation.step(vehicle, 2.5)

        assert [_, _, _] =
                 for({:send, {100, %M.Heartbeat{type: 30, autopilot: 8} = beat}} <- actions, do: beat)

        list = %M.ParamExtRequestList{target_system: 1, target_component: 100}
        {vehicle, []} = Simulation.handle(vehicle, {:message, list, {255, 190}})
        {_vehicle, actions} = Simulation.step(vehicle, 1.0)

        values =
          for {:send, {100, %M.ParamExtValue{} = value}} <- actions, do: {value.param_id, value.param_type}

        assert values == Camera.params()
        assert Enum.map(Camera.params(), &elem(&1, 1)) |> Enum.uniq() == Enum.to_list(1..11)
      end
    end

    test "is not the autopilot" do
      assert {:error, "expected :camera" <> _} = Options.validate(camera: 1)
    end
  end

  describe "parameters" do
    test "values are cut to the range of their type" do
      params = Params.new([{"A", 5, 2}, {"B", 1.1, 9}], :c_cast)
      {:ok, params} = Params.put(params, "A", 300)
      assert Params.get(params, "A") == 127
      assert Params.get(params, "B") == Real32.round32(1.1)
      assert {:error, :unknown} = Params.put(params, "C", 1)
      assert {:error, :value} = Params.set(params, "B", :nan, 9)
      assert {:error, :value} = Params.set(params, "A", :infinity, 2)
    end

    test "the hash is the CRC-32 without inversions over names and bytes" do
      params = Params.new([{"A", 1, 6}, {"B", 1.0, 9}], :bytewise)
      # By hand: the register starts at 0, polynomial 0xEDB88320 reflected.
      data = "A" <> <<1::little-32>> <> "B" <> <<1.0::little-float-32>>

      crc =
        for <<byte <- data>>, reduce: 0 do
          crc ->
            Enum.reduce(1..8, Bitwise.bxor(crc, byte), fn _bit, c ->
              if Bitwise.band(c, 1) == 1,
                do: Bitwise.bxor(Bitwise.bsr(c, 1), 0xEDB88320),
                else: Bitwise.bsr(c, 1)
            end)
        end

      assert Params.hash(params) == crc
    end
  end

  test "bits and 32-bit floats" do
    for bits <- [0, 1, 4, 0x3F80_0000, 0x7F80_0000, 0xFF80_0000, 0xFFFF_FFFF, 0x8000_0000] do
      assert bits |> Real32.from_bits() |> Real32.to_bits() == bits
    end
  end

  test "a text of exactly one chunk is followed by an empty one" do
    assert Texts.split("short") == ["short"]
    assert Texts.split(String.duplicate("x", 50)) == [String.duplicate("x", 50), ""]
    assert Texts.split(String.duplicate("x", 51)) == [String.duplicate("x", 50), "x"]
  end

  test "a battery sags under load and is used up" do
    battery = Battery.new(capacity_mah: 1000.0)
    assert_in_delta Battery.voltage(battery), 12.6, 0.01
    hovering = Battery.step(battery, true, 0.36, 60.0)
    assert_in_delta hovering.used_mah, 28.0 * 60 / 3.6, 1.0
    assert Battery.voltage(hovering) < Battery.voltage(%{hovering | current_a: 0.0})
    empty = Battery.step(battery, true, 1.0, 3600.0)
    assert Battery.remaining(empty) == 0.0
    assert Battery.percent(empty) == 0
    # A threshold that somebody set to -1 mAh.
    assert %{used_mah: 1000.0} = beneath = Battery.set_remaining(battery, -0.001)
    assert Battery.voltage(beneath) > 0
  end

  describe "options" do
    test "an unknown key is refused with a hint" do
      assert {:error, "unknown option :spead, did you mean :speed?; known: " <> _all} =
               Options.validate(spead: 3)

      assert {:error, "unknown option :zzz; known: " <> _all} = Options.validate(zzz: 3)
    end

    test "a wrong value is refused with what was expected" do
      for {key, value} <- [
            firmware: :inav,
            link: "udp:1",
            system: 0,
            home: {91, 0, 0},
            heading: 400,
            speed: 0,
            mavlink: 3,
            battery: [cells: 0],
            rates: %{x: 1},
            params: %{"NO_SUCH" => 1},
            script: [:dance],
            wind: -1,
            seed: "a",
            ready_s: -1
          ] do
        assert {:error, "expected :" <> rest} = Options.validate([{key, value}])
        assert rest =~ "#{key} to be"
        assert rest =~ "got: #{inspect(value)}"
      end

      assert {:error, _text} = SimVehicle.start_link(speed: 0)
      assert_raise ArgumentError, fn -> Options.validate!(speed: 0) end
    end
  end

  test "addresses" do
    assert {:ok, {_module, :client, {127, 0, 0, 1}, 14_550}} = Link.parse("udpout:127.0.0.1:14550")

    for wrong <- [
          "udpout:127.0.0.1",
          "udpout:127.0.0.1:99999",
          "serial:/dev/tty:1",
          "tcp:no.such.host.invalid:1",
          7
        ] do
      assert {:error, "expected udpout:HOST:PORT" <> _rest} = Link.parse(wrong)
    end
  end

  describe "fleet" do
    test "patterns are scripts" do
      for number <- 0..20, do: assert(Pilot.script?(Pilot.pattern(number)))
      refute Pilot.script?([])
      refute Pilot.script?([{:takeoff, -1}])
    end

    test "system ids count up, places differ, too many are refused" do
      options = %{
        count: 10,
        first_system: 5,
        link: "udpout:127.0.0.1:1",
        home: {47.0, 8.0, 400.0},
        spacing: 20.0,
        firmware: :mixed,
        fly: true,
        seed: 1,
        speed: 1.0,
        wind: 0.0,
        ready_s: 1.0,
        rates: %{}
      }

      vehicles = Fleet.vehicles(options)
      assert Enum.map(vehicles, & &1[:system]) == Enum.to_list(5..14)
      assert vehicles |> Enum.map(& &1[:home]) |> Enum.uniq() |> length() == 10
      assert Enum.map(vehicles, & &1[:firmware]) |> Enum.take(3) == [:ardupilot, :ardupilot, :px4]
      assert_raise ArgumentError, fn -> Fleet.vehicles(%{options | count: 300}) end
      assert_raise ArgumentError, ~r/unknown options/, fn -> Fleet.start_link(cuont: 3) end
    end
  end
end
