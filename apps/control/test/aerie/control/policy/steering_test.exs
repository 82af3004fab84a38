defmodule Aerie.Control.Policy.SteeringTest do
  @moduledoc """
  Where set-points, homes and sticks lead a vehicle, as each firmware reads them, under a fence, limits of height and
  denied modes.
  """
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire, only: [decoded: 1]

  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Policy.Mavlink
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Services.Switches
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @copter %{autopilot: :ardupilot, vehicle_type: "copter"}
  @px4 %{autopilot: :px4, vehicle_type: "copter"}
  @plane %{autopilot: :ardupilot, vehicle_type: "plane"}
  @rover %{autopilot: :ardupilot, vehicle_type: "rover"}
  @boat %{autopilot: :px4, vehicle_type: "boat"}
  @sub %{autopilot: :ardupilot, vehicle_type: "sub"}
  @unknown %{autopilot: :generic, vehicle_type: "unknown"}
  @operator %{name: "olga", role: :operator, permissions: []}
  @now 1_795_340_000_000_000
  # Masks that leave only these in force.
  @place 0xDF8
  @velocity 0xDC7
  @both 0xDC0
  @acceleration 0xC3F

  # 100 m to each side of the vehicle, more or less.
  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[7.9987, 46.9991], [8.0013, 46.9991], [8.0013, 47.0009], [7.9987, 47.0009]]]}}
  """

  setup %{tmp_dir: dir} do
    file = Path.join(dir, "fence.geojson")
    File.write!(file, @fence)
    {:ok, fence: %{geofence_file: file}, limit: %{max_altitude: 60}}
  end

  defp context(vehicle, more) do
    groups = %{
      position: %{lat: 47.0, lon: 8.0, alt_rel: 40.0, alt_msl: 540.0, heading: 0.0},
      home: %{lat: 47.0, lon: 8.0, alt_msl: 500.0},
      mode: %{mode: "GUIDED", armed: true, in_air: true}
    }

    groups |> Context.new(@operator, @now) |> struct!(vehicle) |> struct!(more)
  end

  defp judge(section, %module{} = message, vehicle, more \\ %{}) do
    {:ok, policy} = Policy.compile(section)
    facts = if module == Command, do: message, else: Mavlink.facts(decoded(message), vehicle)
    Policy.decide(policy, facts, context(vehicle, more))
  end

  defp local(mask, fields),
    do: struct!(%M.SetPositionTargetLocalNed{coordinate_frame: 1, type_mask: mask, z: -40.0}, fields)

  defp global(mask, fields) do
    here = %M.SetPositionTargetGlobalInt{
      coordinate_frame: 6,
      lat_int: 470_000_000,
      lon_int: 80_000_000,
      alt: 40.0
    }

    struct!(%{here | type_mask: mask}, fields)
  end

  defp command(type, params) do
    {:ok, command} = Command.new([vehicle: "VID-001", type: type, params: params], @now)
    command
  end

  test "masks: what counts of a set-point is judged, whichever axes are masked", c do
    refused = [
      # A place within the fence does not hide a velocity out of it, and the other way round.
      {c.fence, @copter, local(0xDC1, vx: 14.0)},
      {c.fence, @copter, local(0xDC4, vx: 14.0)},
      {c.fence, @copter, global(0xDC4, vx: 14.0)},
      {c.fence, @copter, local(@both, vx: 14.0)},
      {c.fence, @copter, local(@both, x: 90.0, vx: 5.0)},
      {c.fence, @px4, local(0xDE3, vx: 30.0)},
      {c.fence, @px4, local(@both, x: :nan, y: :nan, vx: 30.0)},
      {c.fence, @px4, global(0xDC4, vy: -30.0)},
      {c.fence, @copter, local(@place, x: 500.0)},
      {c.fence, @copter, local(0xDF8, coordinate_frame: 7, x: 150.0)},
      {c.fence, @copter, local(0xDF8, coordinate_frame: 9, y: 150.0)},
      {c.limit, @copter, local(@place, coordinate_frame: 7, z: -30.0)},
      {c.limit, @copter, local(0xDC1, vz: -5.0)},
      {c.limit, @px4, local(0xDE3, z: -80.0, vx: 1.0)},
      {c.limit, @px4, local(0xDDF, vz: -5.0)},
      # Accelerations.
      {c.limit, @px4, local(@acceleration, afz: -1.0)},
      {c.fence, @px4, local(@acceleration, afx: 1.0)},
      {c.fence, @px4, local(0xC3B, z: -40.0, afx: 1.0)},
      {c.limit, @copter, local(@acceleration, afz: -1.0)},
      {c.fence, @copter, global(@acceleration, afx: 1.0)},
      {c.fence, @copter, local(0xC07, vx: 1.0, afx: 5.0)},
      {c.limit, @copter, local(0xC07, vz: 0.0, afz: -3.0)},
      # No numbers.
      {c.fence, @copter, local(@velocity, vx: :nan)},
      {c.fence, @copter, local(@place, x: :infinity)},
      {c.fence, @px4, local(@velocity, vx: :neg_infinity)},
      {c.fence, @copter, local(@velocity, vx: 3.4e38)},
      {c.limit, @copter, global(@place, alt: :nan)},
      # A rover drives where a yaw points, at the speed; ahead is north.
      {c.fence, @rover, local(0x9C7, vx: 0.0, vy: 14.0, yaw: 1.0)},
      {c.fence, @rover, local(0x5C7, vx: 14.0, yaw_rate: 0.1)},
      {c.fence, @boat, local(@velocity, vx: 30.0)},
      {c.fence, @copter, local(0x5C7, coordinate_frame: 8, vx: 14.0, yaw_rate: 0.5)},
      # A plane takes only the height, and that whatever the mask says.
      {c.limit, @plane, global(0xFFF, alt: 90.0)},
      {c.limit, @plane, local(0xFFF, coordinate_frame: 7, z: -5.0)},
      {c.limit, @sub, local(0xDFB, z: -80.0)},
      {c.limit, @unknown, local(@acceleration, afz: -1.0)},
      {c.limit, @unknown, global(0xFFF, alt: 90.0)},
      {c.fence, @copter, %M.SetAttitudeTarget{q: [1.0, 0.0, 0.0, 0.0], thrust: 0.6}},
      {c.limit, @px4, %M.SetAttitudeTarget{q: [1.0, 0.0, 0.0, 0.0], thrust: 0.6, type_mask: 7}}
    ]

    for {section, vehicle, message} <- refused do
      decision = judge(section, message, vehicle)

      assert match?({:deny, rule, _reason} when rule in [:altitude, :geofence], decision),
             inspect({vehicle, message})

      assert judge(%{}, message, vehicle) == :allow
    end

    allowed = [
      {@copter, local(@place, x: 20.0)},
      {@copter, local(@velocity, vx: 3.0)},
      {@copter, local(@both, x: 5.0, vx: 1.0)},
      {@copter, global(@place, [])},
      {@px4, local(0xDE3, vx: 3.0)},
      {@px4, local(0xC00, x: 5.0, vx: 1.0, afx: 0.5)},
      {@px4, local(@both, x: :nan, y: :nan, vx: 3.0)},
      {@copter, local(@velocity, vx: 0.0, vz: 0.0)},
      {@rover, local(0x9C7, vx: 2.0, yaw: 1.0)},
      {@copter, local(0x9FF, yaw: 1.0)},
      {@plane, global(0xFFF, alt: 50.0)}
    ]

    for {vehicle, message} <- allowed,
        do: assert({message, judge(Map.merge(c.fence, c.limit), message, vehicle)} == {message, :allow})
  end

  test "a velocity is flown until the vehicle's own time-out, and braking takes its way as well", c do
    fast = &command("setpoint_velocity", Map.merge(%{vx: 8, vy: 0, vz: 0, hold: 0.2}, &1))
    # 100 m to the border: 8 m/s take 4.2 s and 21 m.
    assert judge(c.fence, fast.(%{}), @copter) == :allow
    assert {:deny, :geofence, _} = judge(c.fence, fast.(%{vx: 14}), @copter)
    assert judge(c.fence, fast.(%{vx: 12}), @px4) == :allow
    # The gateway repeats it.
    assert {:deny, :geofence, _} = judge(c.fence, fast.(%{hold: 10}), @copter)
    assert {:deny, :geofence, _} = judge(c.fence, fast.(%{}), @copter, %{params: %{"GUID_TIMEOUT" => 10}})
    assert {:deny, :geofence, _} = judge(c.fence, fast.(%{}), @px4, %{params: %{"COM_OF_LOSS_T" => 60.0}})
    # Sideways its nose may turn.
    assert {:deny, :geofence, _} = judge(c.fence, fast.(%{vx: 0, vy: 14, frame: "body"}), @copter)
    climb = &command("setpoint_velocity", %{vx: 0, vy: 0, vz: -&1, hold: 0.2})
    assert judge(c.limit, climb.(2), @copter) == :allow
    assert {:deny, :altitude, _} = judge(c.limit, climb.(4), @copter)
  end

  test "home that was moved in flight lifts no limit, and moves no band of a fence", c do
    # It took off at 500 m; home has been moved up to 540 m since.
    moved = %{home: %{lat: 47.0, lon: 8.0, alt_msl: 540.0}, datums: [500.0]}
    goto = &command("goto", %{lat: 47.0, lon: 8.0005, altitude: &1})
    assert judge(c.limit, goto.(15), @copter, moved) == :allow

    assert judge(c.limit, goto.(55), @copter, moved) ==
             {:deny, :altitude, "the target is 95 m above where it took off; at most 60 m is allowed"}

    band = String.replace(@fence, ~s("name": "field"), ~s("name": "field", "max_altitude": 60))
    File.write!(c.fence.geofence_file, band)
    assert {:deny, :geofence, _} = judge(c.fence, goto.(55), @copter, moved)
    assert judge(c.fence, goto.(15), @copter, moved) == :allow
    # Local coordinates still begin where it took off.
    low = %{moved | datums: []} |> Map.put(:origin, %{lat: 47.0, lon: 8.0, alt_msl: 600.0})
    assert {:deny, :altitude, _} = judge(c.limit, local(@place, z: -40.0), @copter, low)
  end

  test "moving home in flight needs `protection`, by every message", _c do
    home = MavCmd.value(:MAV_CMD_DO_SET_HOME)

    ways = [
      command("set_home", %{here: true}),
      command("set_home", %{lat: 47.0, lon: 8.0, altitude_msl: 520}),
      %M.CommandLong{command: home, param1: 1.0},
      %M.CommandInt{command: home, x: 470_000_000, y: 80_000_000, z: 520.0},
      %M.SetHomePosition{latitude: 470_000_000, longitude: 80_000_000, altitude: 520_000}
    ]

    for way <- ways, vehicle <- [@copter, @px4] do
      assert {:deny, :role, "set_home needs the permission protection" <> _} = judge(%{}, way, vehicle)
      assert judge(%{}, way, vehicle, %{in_air: false}) == :allow
      assert judge(%{}, way, vehicle, %{source: %{@operator | permissions: [:protection]}}) == :allow
    end

    item = %M.MissionItemInt{seq: 3, frame: 3, command: home, x: 470_000_000, y: 80_000_000, z: 5.0}
    assert {:deny, :role, _} = judge(%{}, item, @copter, %{in_air: false})
    origin = %M.SetGpsGlobalOrigin{latitude: 470_000_000, longitude: 80_000_000}
    maintainer = %{@operator | permissions: [:maintain]}
    assert {:deny, :role, _} = judge(%{}, origin, @copter, %{source: maintainer})
    assert judge(%{}, origin, @copter, %{source: maintainer, in_air: false}) == :allow
  end

  test "a disarmed vehicle is given nothing that would move it once it is armed" do
    cmd = &MavCmd.value(:"MAV_CMD_#{&1}")
    place = [frame: 6, x: 470_000_000, y: 80_000_000, z: 40.0]
    reposition = struct!(%M.CommandInt{command: cmd.("DO_REPOSITION"), param2: 1.0}, place)
    start = %M.CommandLong{command: cmd.("MISSION_START")}
    item = struct!(%M.MissionItemInt{current: 2, command: 16}, place)
    disarmed = %{armed: false, in_air: false}

    for message <- [
          reposition,
          item,
          start,
          local(@place, x: 5.0),
          local(@velocity, vx: 1.0),
          global(@place, [])
        ],
        vehicle <- [@copter, @rover, @plane, %{@rover | vehicle_type: "boat"}] do
      assert {:deny, :disarmed, _} = judge(%{}, message, vehicle, disarmed), inspect({message, vehicle})
      assert judge(%{}, message, vehicle) == :allow
    end

    return = %M.CommandLong{command: cmd.("NAV_RETURN_TO_LAUNCH")}
    assert {:deny, :disarmed, _} = judge(%{}, return, @rover, disarmed)
    assert judge(%{}, return, @copter, disarmed) == :allow
    # PX4 arms by it, and wants set-points before it is armed.
    for message <- [
          start,
          local(@velocity, vx: 1.0),
          %M.CommandLong{command: cmd.("NAV_TAKEOFF"), param7: 540.0}
        ],
        do: assert(judge(%{}, message, @px4, disarmed) == :allow)

    assert {:deny, :disarmed, _} = judge(%{}, reposition, @px4, disarmed)
  end

  test "an override of the mode channel, a switch's function and a button may enter no denied mode" do
    denied = %{modes: %{denied: ["RTL"]}}

    override =
      &struct!(%M.RcChannelsOverride{}, Map.new(1..8, fn n -> {:"chan#{n}_raw", Map.get(&1, n, 65_535)} end))

    modes = for {mode, n} <- Enum.with_index([0, 2, 6, 5, 3, 4], 1), into: %{}, do: {"FLTMODE#{n}", mode}
    options = for n <- 5..16, into: %{}, do: {"RC#{n}_OPTION", 0}

    known = %{
      params:
        modes |> Map.merge(options) |> Map.merge(%{"FLTMODE_CH" => 5, "RC7_OPTION" => 4, "RC8_OPTION" => 31})
    }

    assert judge(denied, override.(%{1 => 1500, 3 => 1700}), @copter) == :allow
    assert {:deny, :mode, _} = judge(denied, override.(%{5 => 1400}), @copter)
    assert {:deny, :mode, "the mode RTL" <> _} = judge(denied, override.(%{5 => 1400}), @copter, known)
    assert judge(denied, override.(%{5 => 1500}), @copter, known) == :allow
    assert judge(denied, override.(%{5 => 0}), @copter, known) == :allow
    assert judge(denied, override.(%{6 => 1900}), @copter, known) == :allow
    assert {:deny, :mode, _} = judge(denied, override.(%{7 => 1900}), @copter, known)
    assert {:deny, :role, _} = judge(%{}, override.(%{8 => 1900}), @copter, known)
    assert {:deny, :role, _} = judge(%{}, override.(%{5 => 1400}), @copter)

    # The same by the command.
    channels = &command("rc_override", %{channels: [0, 0, 0, 0, &1]})
    assert {:deny, :mode, _} = judge(denied, channels.(1400), @copter, known)
    assert judge(denied, channels.(1700), @copter, known) == :allow

    rover = %{params: Map.merge(options, %{"MODE_CH" => 8, "MODE1" => 11, "MODE2" => 0})}
    assert {:deny, :mode, _} = judge(denied, override.(%{8 => 1000}), @rover, rover)
    assert judge(denied, override.(%{8 => 1300}), @rover, rover) == :allow
    # PX4's depend on a calibration.
    px4 = %{params: Map.new(Switches.plan({:px4, "copter"}), &{&1, 0})}
    assert judge(%{modes: %{denied: ["AUTO_RTL"]}}, override.(%{6 => 1500}), @px4, px4) == :allow

    assert {:deny, :mode, _} =
             judge(
               %{modes: %{denied: ["AUTO_RTL"]}},
               override.(%{6 => 1500}),
               @px4,
               put_in(px4.params["RC_MAP_RETURN_SW"], 6)
             )

    assert {:deny, :mode, _} = judge(denied, %M.RadioRcChannels{}, @copter, known)
    # Only a submarine's buttons have functions.
    pressed = %M.ManualControl{buttons: 0b10}
    buttons = %{params: %{"BTN1_FUNCTION" => 9, "BTN1_SFUNCTION" => 0}}
    assert {:deny, :mode, _} = judge(%{modes: %{denied: ["AUTO"]}}, pressed, @sub, buttons)
    assert judge(%{modes: %{denied: ["MANUAL"]}}, pressed, @sub, buttons) == :allow
    assert {:deny, :mode, _} = judge(denied, pressed, @sub)
    assert judge(denied, pressed, @copter) == :allow
  end
end
