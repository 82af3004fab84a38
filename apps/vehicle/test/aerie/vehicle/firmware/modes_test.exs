defmodule Aerie.Vehicle.Firmware.ModesTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Protocol.Kind

  test "names of each firmware" do
    assert Modes.name(:ardupilot, "copter", 81, 4) == "GUIDED"
    assert Modes.name(:ardupilot, "rover", 81, 4) == "HOLD"
    assert Modes.name(:ardupilot, "sub", 81, 19) == "MANUAL"
    assert Modes.name(:ardupilot, "plane", 81, 5) == "FBWA"
    assert Modes.name(:ardupilot, "vtol", 81, 19) == "QLOITER"
    assert Modes.name(:ardupilot, "boat", 81, 10) == "AUTO"
    assert Modes.name(:ardupilot, "copter", 81, 29) == "RATE_ACRO"
    assert Enum.map([5, 6], &Modes.name(:ardupilot, "blimp", 81, &1)) == ["AUTO", "HOLD"]
    assert Modes.name(:ardupilot, "rover", 81, 2) == "LEARNING"
    assert Modes.name(:ardupilot, "plane", 81, 25) == "LOITER_ALT_QLAND"
    assert Enum.map([5, 6, 16], &Modes.name(:ardupilot, "plane", 81, &1)) == ~w(FBWA FBWB INITIALISING)
    assert Modes.name(:px4, "copter", 157, 50_593_792) == "AUTO_LOITER"
    assert Modes.name(:px4, "copter", 145, 16_973_824) == "POSCTL_ORBIT"
    assert Modes.name(:px4, "copter", 145, 393_216) == "OFFBOARD"
    assert Modes.name(:px4, "plane", 157, 100_925_440) == "AUTO_LAND"
  end

  test "an unknown number is shown as a number and comes back" do
    assert Modes.name(:ardupilot, "copter", 81, 99) == "MODE(99)"
    assert Modes.name(:ardupilot, "unknown", 81, 4) == "MODE(4)"
    assert Modes.name(:px4, "copter", 81, 0x63040000) == "MODE(1661206528)"
    assert Modes.name(:px4, "copter", 81, 4) == "MODE(4)"
    assert Modes.number(:ardupilot, "copter", "mode(99)") == {:ok, 99}
  end

  test "a number that the firmware would read as another mode is refused" do
    for number <- [256, 257, 65_536],
        do: assert(Modes.number(:ardupilot, "copter", "MODE(#{number})") == :error)

    for number <- [1, 65_535, 0x50001, 0x100000000],
        do: assert(Modes.number(:px4, "copter", "MODE(#{number})") == :error)
  end

  test "what a firmware makes of a request" do
    assert Modes.asked(:ardupilot, "copter", 1, 4) == ["GUIDED"]
    assert Modes.asked(:ardupilot, "copter", 1, 200) == ["MODE(200)"]

    assert {:error, "the mode 257 is not an integer from 0 to 255"} =
             Modes.asked(:ardupilot, "copter", 1, 257)

    assert Modes.asked(:px4, "copter", 1, 0x03040000) == ["AUTO_LOITER"]
    # Without a sub mode it is the mission, and of most main modes PX4 takes no notice of the sub mode.
    assert Modes.asked(:px4, "copter", 1, 0x00040000) == ["AUTO_MISSION"]
    assert Modes.asked(:px4, "copter", 1, 0x09050000) == ["ACRO"]
    assert Modes.asked(:px4, "copter", 1, 0x01030000) == ["POSCTL_ORBIT", "POSCTL"]
    assert Modes.asked(:px4, "copter", 1, 0x63040000) == ["MODE(1661206528)"]
    assert {:error, _reason} = Modes.asked(:px4, "copter", 1, 0x00050001)
    # Without the flag for its own modes it goes by the others.
    assert Modes.asked(:px4, "copter", 64, 0x03040000) == ["MANUAL", "AUTO_LOITER"]
    assert Modes.asked(:px4, "copter", 4, 0) == ["AUTO_MISSION"]
    assert Modes.asked(:generic, "unknown", 5, 7) == ["AUTO", "MODE(7)"]
  end

  test "an autopilot without modes of its own has those of the heartbeat's flags" do
    assert Modes.name(:generic, "copter", 0x04, 7) == "AUTO"
    assert Modes.name(:generic, "copter", 0x40, 0) == "MANUAL"
    assert Modes.name(:generic, "copter", 0x01, 7) == "MODE(7)"
    assert Modes.name(:generic, "copter", 0, 0) == "PREFLIGHT"
  end

  test "every name leads back to its number" do
    for {autopilot, kind} <-
          [px4: "copter"] ++ for(k <- ~w(copter plane vtol rover boat sub tracker blimp), do: {:ardupilot, k}),
        name <- Modes.all(autopilot, kind) do
      assert {:ok, number} = Modes.number(autopilot, kind, String.downcase(name))
      assert Modes.name(autopilot, kind, 1, number) == name
    end

    assert Modes.all(:generic, "copter") == []
  end

  test "common short names of PX4's modes; unknown names are an error" do
    assert Modes.number(:px4, "copter", "hold") == Modes.number(:px4, "copter", "AUTO_LOITER")
    assert Modes.number(:px4, "copter", "RTL") == {:ok, 84_148_224}
    assert Modes.number(:ardupilot, "rover", "LAND") == :error
    assert Modes.number(:generic, "copter", "AUTO") == :error
    assert Modes.number(:ardupilot, "copter", "MODE(-1)") == :error
  end

  test "kinds" do
    assert Enum.map([1, 2, 10, 11, 12, 22, 200], &Kind.name/1) == ~w(plane copter rover boat sub vtol unknown)
    assert Kind.flies?("vtol") and Kind.flies?("unknown") and not Kind.flies?("rover")
  end

  describe "modes that an application brings along" do
    import Aerie.Flight, only: [frame: 2, options: 1, step: 2]

    alias Aerie.Vehicle.Events.Detector
    alias Aerie.Vehicle.Session.Core
    alias MavCodec.Messages, as: M

    @external 4 * 0x10000 + 12 * 0x1000000

    defp beat(at, mode),
      do:
        frame(
          %M.Heartbeat{type: 2, autopilot: 12, base_mode: 81, custom_mode: mode, system_status: 3},
          at * 1_000_000
        )

    defp named(at, mode, name),
      do:
        frame(
          %M.AvailableModes{number_modes: 9, mode_index: 1, custom_mode: mode, mode_name: name},
          at * 1_000_000
        )

    defp fly(frames) do
      options = options([])

      start = %{
        core: Core.new(options),
        detector: Detector.new(options),
        events: [],
        actions: [],
        params: %{}
      }

      Enum.reduce(frames, start, &step(&2, {:frames, "link", [&1]}))
    end

    defp asked(run),
      do: for({:send, %M.CommandLong{command: 512, param1: 435.0}, _} <- run.actions, do: :asked)

    test "are asked for when one is flown, and shown by the name that they have" do
      loiter = 4 * 0x10000 + 3 * 0x1000000
      before = for s <- 1..10, do: beat(s, loiter)
      assert asked(fly(before)) == []
      unnamed = fly(before ++ for(s <- 11..80, do: beat(s, @external)))
      assert asked(unnamed) != []

      run =
        Enum.reduce(
          [
            named(81, loiter, "Hold"),
            named(81, @external, "Search\xFF pattern"),
            beat(82, @external),
            beat(83, loiter)
          ],
          unnamed,
          &step(&2, {:frames, "link", [&1]})
        )

      # The name that comes later is not a change of the mode.
      assert for(
               %{type: "mode_change", data: data} <- Enum.reverse(run.events),
               do: {data["from"], data["to"]}
             ) ==
               [{"AUTO_LOITER", "EXTERNAL2"}, {"Search\uFFFD pattern", "AUTO_LOITER"}]
    end

    test "standard modes (X4): asked for once a vehicle shows that it has them, and again when they have changed" do
      start = for s <- 1..10, do: beat(s, 3 * 0x10000)
      monitor = fn at, seq -> frame(%M.AvailableModesMonitor{seq: seq}, at * 1_000_000) end
      current = frame(%M.CurrentMode{standard_mode: 1, custom_mode: 3 * 0x10000}, 10_000_000)
      run = fly(start ++ [current | for(s <- 11..80, do: beat(s, 3 * 0x10000))])
      times = length(asked(run))
      assert times > 0

      standard = fn at, standard, mode ->
        frame(%M.AvailableModes{standard_mode: standard, custom_mode: mode}, at * 1_000_000)
      end

      told = [
        standard.(81, 1, 3 * 0x10000),
        standard.(81, 7, @external),
        named(81, @external, "Soft landing")
      ]

      run = Enum.reduce(told, run, &step(&2, {:frames, "link", [&1]}))
      snapshot = Map.put(Core.snapshot(run.core), :key, {"main", 1})
      assert snapshot.memory.standard_modes == %{"position_hold" => 3 * 0x10000, "land" => @external}

      # Commands know them by the names of the vehicle's state.
      command = Aerie.CommandSamples.command("set_mode", %{standard_mode: "land"})
      told = Map.take(snapshot.memory, [:mode_names, :standard_modes])
      vehicle = struct!(%Aerie.Vehicle.Protocol.Vehicle{system: 1, autopilot: :px4, kind: "copter"}, told)

      assert {:ok, [%{confirm: {:mode, ["Soft landing"]}}]} =
               Aerie.Vehicle.Protocol.plan(Aerie.Vehicle.Firmware.Px4.Adapter, command, vehicle)

      changed = [monitor.(82, 3) | for(s <- 83..150, do: beat(s, 3 * 0x10000))]
      run = Enum.reduce(changed, run, &step(&2, {:frames, "link", [&1]}))
      assert length(asked(run)) > times
      assert run.core.state.standard_modes == %{}
    end

    test "are a few" do
      run = fly([beat(1, 0) | for(n <- 1..500, do: named(2, n, "mode \#{n}"))])
      assert map_size(run.core.state.mode_names) == 64
    end
  end

  test "a mode that the firmware does not arm in has another one to be set first" do
    assert Modes.arm_first(:ardupilot, "copter", "LAND") == "GUIDED"
    assert Modes.arm_first(:ardupilot, "copter", "RTL") == "GUIDED"
    assert Modes.arm_first(:ardupilot, "vtol", "QRTL") == "GUIDED"

    for {autopilot, kind, mode} <- [
          {:ardupilot, "copter", "GUIDED"},
          {:ardupilot, "copter", "STABILIZE"},
          {:ardupilot, "rover", "RTL"},
          {:ardupilot, "copter", nil},
          {:px4, "copter", "AUTO_LAND"}
        ],
        do: assert(Modes.arm_first(autopilot, kind, mode) == nil)

    # Each is a mode, and so is the one that comes first.
    for kind <- ["copter", "vtol"],
        mode <- Modes.all(:ardupilot, kind),
        first = Modes.arm_first(:ardupilot, kind, mode) do
      assert {:ok, _number} = Modes.number(:ardupilot, kind, first)
      assert Modes.arm_first(:ardupilot, kind, first) == nil
    end
  end

  test "what a vehicle does in a mode agrees with MAVLink's standard modes" do
    same = %{"safe_recovery" => :return, "mission" => :mission, "land" => :land, "takeoff" => :take_off}

    for firmware <- [:ardupilot, :px4],
        kind <- ~w(copter plane vtol rover boat sub blimp),
        {standard, mode} <- Aerie.Vehicle.Firmware.traits(firmware).modes.standard(kind),
        action = same[standard],
        do: assert(Aerie.Vehicle.Firmware.action(mode) == action, "#{firmware} #{kind} #{mode}")

    for mode <- ["ACRO", "MODE(27)", "", nil], do: assert(Aerie.Vehicle.Firmware.action(mode) == nil)
  end

  test "a mode by its meaning, and its meaning in words" do
    alias Aerie.Vehicle.Firmware
    vehicle = fn firmware, kind -> %{autopilot: firmware, vehicle_type: kind, memory: %{}} end
    mode = fn firmware, kind, action -> Firmware.mode_for(vehicle.(firmware, kind), action) end

    assert {mode.(:ardupilot, "copter", :mission), mode.(:px4, "copter", :mission)} ==
             {"AUTO", "AUTO_MISSION"}

    assert {mode.(:ardupilot, "plane", :guided), mode.(:ardupilot, "vtol", :return)} == {"GUIDED", "RTL"}
    assert {mode.(:ardupilot, "plane", :take_off), mode.(:ardupilot, "copter", :take_off)} == {"TAKEOFF", nil}
    # Betaflight says by itself which modes it has.
    own = %{vehicle.(:betaflight, "copter") | memory: %{mode_names: %{7 => "ALTHOLD"}}}
    assert {Firmware.mode_for(own, :hold_height), Firmware.mode_for(own, :mission)} == {"ALTHOLD", nil}

    assert Enum.map(~w(AUTO_LOITER AUTO_LAND OFFBOARD RTL), &Firmware.meaning/1) ==
             ~w(Hold Land Guided Return)

    assert Enum.map(["ACRO", "MODE(27)", nil], &Firmware.meaning/1) == [nil, nil, nil]
  end
end
