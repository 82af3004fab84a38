defmodule Aerie.Control.PolicyTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Intent.Context

  # Sunday, 22 November 2026, 09:30 UTC
  @now DateTime.to_unix(~U[2026-11-22 09:30:00Z], :microsecond)
  @operator %{name: "olga", role: :operator, permissions: []}
  # Who may move home in flight.
  @keeper %{@operator | permissions: [:protection]}
  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.02, 47.0], [8.02, 47.02], [8.0, 47.02]],
                                                   [[8.009, 47.009], [8.011, 47.009], [8.011, 47.011], [8.009, 47.011]]]}}
  """
  @vehicle %{
    position: %{lat: 47.001, lon: 8.001, alt_rel: 20.0, alt_msl: 520.0, heading: 90.0},
    home: %{lat: 47.001, lon: 8.0005, alt_msl: 500.0},
    mode: %{mode: "GUIDED", armed: true, in_air: true},
    battery: %{remaining: 0.8}
  }

  setup_all do
    dir = Path.join(System.tmp_dir!(), "policy-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dir)
    on_exit(fn -> File.rm_rf!(dir) end)
    path = Path.join(dir, "fence.geojson")
    File.write!(path, @fence)
    {:ok, fence: path}
  end

  defp command(type, params \\ %{}) do
    {:ok, command} = Command.new([vehicle: "VID-001", type: type, params: params], @now)
    command
  end

  defp policy(section) do
    {:ok, policy} = Policy.compile(section)
    policy
  end

  defp context(vehicle \\ %{}, source \\ @operator, now \\ @now) do
    merged = Map.merge(@vehicle, vehicle, fn _group, known, changed -> Map.merge(known, changed) end)
    Context.new(Map.reject(merged, fn {_group, data} -> data == %{gone: true} end), source, now)
  end

  defp without(group), do: @vehicle |> Map.delete(group) |> Context.new(@operator, @now)

  # Each row: section, command, context, and what is decided.
  defp table(rows) do
    for {section, command, context, expected} <- rows,
        do:
          assert(
            {section, command, Policy.decide(policy(section), command, context)} ==
              {section, command, expected}
          )
  end

  defp goto(lat, lon, altitude \\ 20, reference \\ "home"),
    do: command("goto", %{lat: lat, lon: lon, altitude: altitude, altitude_reference: reference})

  test "role: permissions by role, and those that no role includes" do
    viewer = %{name: "victor", role: :viewer, permissions: [:force_disarm]}
    admin = %{name: "ada", role: :admin, permissions: []}

    table([
      {%{}, command("arm"), context(), :allow},
      {%{}, command("arm"), context(%{}, nil),
       {:deny, :role, "arm needs the permission arm, and nobody is signed in"}},
      {%{}, command("arm"), context(%{}, viewer),
       {:deny, :role, "arm needs the permission arm; victor is viewer, which does not include it"}},
      {%{}, command("save_params"), context(),
       {:deny, :role,
        "save_params needs the permission maintain; olga is operator, which does not include it"}},
      {%{}, command("save_params"), context(%{}, admin), :allow},
      # A vehicle with MSP is armed by channels in the place of its pilot's.
      {%{}, command("arm"), %{context(%{}, admin) | autopilot: :inav},
       {:deny, :role,
        "arm needs the permission receiver, which no role includes; ada (admin) was not given it"}},
      {%{}, command("manual_control"),
       %{context(%{}, %{admin | permissions: [:receiver]}) | autopilot: :betaflight}, :allow},
      {%{}, command("disarm"), %{context(%{}, admin) | autopilot: :inav, in_air: false}, :allow},
      {%{}, command("motor_test", %{motor: 1, throttle: 0.1, duration: 1}),
       %{context(%{}, admin) | autopilot: :inav, armed: false, in_air: false},
       {:deny, :role,
        "motor_test needs the permission motors, which no role includes; ada (admin) was not given it"}},
      {%{}, command("force_disarm"), context(%{}, admin),
       {:deny, :role,
        "force_disarm needs the permission force_disarm, which no role includes; ada (admin) was not given it"}},
      {%{}, command("force_disarm"), context(%{}, %{@operator | permissions: [:force_disarm]}), :allow},
      {%{}, command("force_disarm"), context(%{}, viewer),
       {:deny, :role,
        "force_disarm needs the permission force_disarm, which no role includes; victor (viewer) was not given it"}}
    ])
  end

  test "protection: what takes one away needs it besides" do
    maintainer = %{@operator | permissions: [:maintain]}
    admin = %{name: "ada", role: :admin, permissions: []}
    lacking = "; olga is operator, which does not include it"

    table([
      {%{}, command("set_geofence", %{enabled: true}), context(), :allow},
      {%{}, command("set_geofence", %{enabled: false}), context(),
       {:deny, :role, "set_geofence needs the permission protection" <> lacking}},
      {%{}, command("set_geofence", %{enabled: false}), context(%{}, admin), :allow},
      {%{}, command("reset_params"), context(%{}, maintainer),
       {:deny, :role, "reset_params needs the permission protection" <> lacking}},
      {%{}, command("reset_params"), context(%{mode: %{armed: false, in_air: false}}, admin), :allow},
      {%{}, command("set_mode", %{mode: "TERMINATION"}), context(%{}, admin),
       {:deny, :role,
        "set_mode needs the permission terminate, which no role includes; ada (admin) was not given it"}}
    ])
  end

  test "on the ground, whatever may make it take off is a take-off" do
    ground = &context(%{mode: %{in_air: false}, battery: &1})
    battery = %{takeoff_battery: 0.3}
    condition = %{conditions: [%{types: ["takeoff"], armed: false, in_air: nil}]}
    window = %{windows: [%{types: ["takeoff"], days: [:mon], from: "08:00", to: "18:00"}]}

    for command <- [
          command("mission_start"),
          command("resume"),
          command("jump", %{tag: 1}),
          command("mission_set_current", %{seq: 1}),
          command("land_start"),
          command("orbit", %{radius: 50}),
          goto(47.001, 8.001),
          command("set_mode", %{mode: "AUTO"}),
          command("set_mode", %{mode: "guided"}),
          command("set_mode", %{mode: "OFFBOARD"}),
          command("set_mode", %{mode: "MODE(77)"}),
          command("set_mode", %{standard_mode: "mission"}),
          command("set_mode", %{standard_mode: "takeoff"})
        ] do
      assert {:deny, :battery, _} = Policy.decide(policy(battery), command, ground.(%{remaining: 0.2}))
      assert Policy.decide(policy(battery), command, ground.(%{remaining: 0.4})) == :allow
      assert Policy.decide(policy(battery), command, context(%{battery: %{remaining: 0.2}})) == :allow
      assert {:deny, :condition, _} = Policy.decide(policy(condition), command, ground.(%{remaining: 0.4}))
      assert Policy.decide(policy(condition), command, context()) == :allow
      assert {:deny, :window, _} = Policy.decide(policy(window), command, ground.(%{remaining: 0.4}))
      assert Policy.decide(policy(window), command, context()) == :allow
    end

    for mode <- ~w(RTL LAND LOITER STABILIZE),
        do:
          assert(
            Policy.decide(policy(battery), command("set_mode", %{mode: mode}), ground.(%{remaining: 0.2})) ==
              :allow
          )
  end

  test "mode: a number is the mode that the firmware makes of it, and what has no name counts as denied" do
    copter = &%{context() | autopilot: &1, vehicle_type: "copter"}
    acro = %{modes: %{denied: ["ACRO"]}}

    decide = fn section, mode, context ->
      Policy.decide(policy(section), command("set_mode", %{mode: mode}), context)
    end

    for mode <- ["MODE(1)", "acro", "MODE(257)", "MODE(200)", "NO_SUCH_MODE"],
        do: assert({:deny, :mode, _} = decide.(acro, mode, copter.(:ardupilot)))

    for mode <- [
          "MODE(#{Bitwise.bsl(5, 16)})",
          "MODE(#{Bitwise.bsl(5, 16) + 1})",
          "MODE(#{Bitwise.bsl(5, 16) + Bitwise.bsl(9, 24)})"
        ],
        do: assert({:deny, :mode, _} = decide.(acro, mode, copter.(:px4)))

    transitions = %{modes: %{transitions: %{"AUTO" => ["RTL"]}}}
    assert {:deny, :mode, _} = decide.(transitions, "MODE(200)", copter.(:ardupilot))
    assert decide.(acro, "MODE(4)", copter.(:ardupilot)) == :allow
    assert decide.(acro, "MODE(#{Bitwise.bsl(4, 16) + Bitwise.bsl(3, 24)})", copter.(:px4)) == :allow
    assert decide.(%{}, "MODE(200)", copter.(:ardupilot)) == :allow
  end

  test "every permission of the table belongs to a role or stands alone" do
    given = Roles.permissions(:admin) ++ Roles.own()
    assert Enum.sort(given) == Enum.sort(Command.Type.permissions())
  end

  test "window: times of day and days, in UTC" do
    at = fn time -> context(%{}, @operator, DateTime.to_unix(time, :microsecond)) end
    week = %{windows: [%{types: nil, days: [:mon, :fri], from: "08:00", to: "18:00"}]}
    night = %{windows: [%{types: ["arm"], days: [:fri], from: "22:00", to: "06:00"}]}
    any = %{windows: [%{types: ["arm"], days: nil, from: "00:00", to: "24:00"}]}

    table([
      {week, goto(47.0, 8.0), context(),
       {:deny, :window, "goto is allowed mon, fri 08:00 to 18:00 UTC only; it is sun 09:30 UTC"}},
      {week, goto(47.0, 8.0), at.(~U[2026-11-23 08:00:00Z]), :allow},
      {week, goto(47.0, 8.0), at.(~U[2026-11-23 07:59:59.999Z]),
       {:deny, :window, "goto is allowed mon, fri 08:00 to 18:00 UTC only; it is mon 07:59 UTC"}},
      {week, goto(47.0, 8.0), at.(~U[2026-11-23 18:00:00Z]),
       {:deny, :window, "goto is allowed mon, fri 08:00 to 18:00 UTC only; it is mon 18:00 UTC"}},
      # What brings a vehicle back is never kept waiting, and what does not move it is not meant.
      {week, command("rtl"), context(), :allow},
      {week, command("land"), context(), :allow},
      {week, command("disarm"), context(), :allow},
      {week, command("request_message", %{message_id: 33}), context(), :allow},
      # Over midnight; the night belongs to the day on which it begins.
      {night, command("arm"), at.(~U[2026-11-27 23:00:00Z]), :allow},
      {night, command("arm"), at.(~U[2026-11-28 05:59:00Z]), :allow},
      {night, command("arm"), at.(~U[2026-11-27 05:59:00Z]),
       {:deny, :window, "arm is allowed fri 22:00 to 06:00 UTC only; it is fri 05:59 UTC"}},
      {night, goto(47.0, 8.0), context(), :allow},
      {any, command("arm"), context(), :allow}
    ])
  end

  test "condition: armed and in the air, by default for what is dangerous in flight" do
    admin = %{@operator | role: :admin}
    armed = fn armed -> context(%{mode: %{armed: armed, in_air: false}}, admin) end
    flying = %{conditions: [%{types: ["gripper"], armed: nil, in_air: false}]}

    table([
      {%{}, command("reboot"), armed.(true),
       {:deny, :condition, "reboot is allowed only while the vehicle is disarmed; it is armed"}},
      {%{}, command("reboot"), armed.(false), :allow},
      {%{}, command("reboot"), armed.(nil),
       {:deny, :condition,
        "reboot is allowed only while the vehicle is disarmed; whether it is, is not known"}},
      {flying, command("gripper", %{action: "release"}), context(),
       {:deny, :condition, "gripper is allowed only while the vehicle is on the ground; it is in the air"}},
      {flying, command("gripper", %{action: "release"}), context(%{mode: %{in_air: false}}), :allow},
      {flying, command("reboot"), armed.(true),
       {:deny, :condition, "reboot is allowed only while the vehicle is disarmed; it is armed"}},
      {%{conditions: [%{types: ["reboot"], armed: nil, in_air: false}]}, command("reboot"), armed.(true),
       :allow}
    ])

    # The whole workshop, on a bench alone; what is not known counts as flying.
    params = %{
      "motor_test" => %{motor: 1, throttle: 0.1, duration: 1},
      "rx_pair" => %{receiver: "crsf"},
      "calibrate" => %{sensor: "gyro"},
      "calibrate_position" => %{position: "level"}
    }

    for type <- ~w(reboot reset_params motor_test rx_pair calibrate calibrate_position calibrate_accept),
        {armed, in_air} <- [
          {true, false},
          {true, true},
          {false, true},
          {nil, false},
          {false, nil},
          {nil, nil}
        ] do
      asked = command(type, Map.get(params, type, %{}))
      state = context(%{mode: %{armed: armed, in_air: in_air}}, admin)
      assert {^type, {:deny, :condition, _why}} = {type, Policy.decide(policy(%{}), asked, state)}
      state = context(%{mode: %{armed: false, in_air: false}}, admin)
      assert Policy.decide(policy(%{}), asked, state) == :allow
    end

    # A calibration can always be ended.
    assert Policy.decide(policy(%{}), command("calibrate_cancel"), armed.(true)) == :allow
  end

  test "battery: no take-off below the floor" do
    floor = %{takeoff_battery: 0.3}
    charge = fn share -> context(%{battery: %{remaining: share}, mode: %{in_air: false}}) end

    table([
      {floor, command("takeoff", %{altitude: 10}), charge.(0.3), :allow},
      {floor, command("takeoff", %{altitude: 10}), charge.(0.2999),
       {:deny, :battery, "takeoff needs 30 % of the battery's charge; 29.9 % is left"}},
      {floor, command("arm"), charge.(nil),
       {:deny, :battery, "arm needs 30 % of the battery's charge; how much is left is not known"}},
      {floor, command("mission_start"), charge.(0.1),
       {:deny, :battery, "mission_start needs 30 % of the battery's charge; 10 % is left"}},
      {floor, command("mission_start"), context(%{battery: %{remaining: 0.1}}), :allow},
      {floor, command("land"), charge.(0.1), :allow},
      {%{}, command("takeoff", %{altitude: 10}), charge.(0.01), :allow}
    ])
  end

  test "mode: denied ones and transitions" do
    modes = %{modes: %{denied: ["acro"], transitions: %{"auto" => ["LOITER", "rtl"]}}}
    set = &command("set_mode", %{mode: &1})
    auto = context(%{mode: %{mode: "AUTO"}})

    table([
      {modes, set.("ACRO"), context(), {:deny, :mode, "the mode ACRO is not allowed (modes.denied)"}},
      {modes, set.("Acro"), context(), {:deny, :mode, "the mode ACRO is not allowed (modes.denied)"}},
      {modes, set.("STABILIZE"), context(), :allow},
      {modes, set.("LOITER"), auto, :allow},
      {modes, set.("AUTO"), auto, :allow},
      {modes, set.("GUIDED"), auto,
       {:deny, :mode, "from AUTO the mode may change to LOITER, RTL only, not to GUIDED"}},
      {modes, set.("LOITER"), without(:mode),
       {:deny, :mode,
        "whether the mode may change to LOITER depends on the vehicle's mode, which is not known"}},
      {modes, command("set_mode", %{standard_mode: "orbit"}), context(),
       {:deny, :mode, "which of its modes the standard mode orbit is for this vehicle is not known"}},
      {modes, command("set_mode", %{standard_mode: "orbit"}),
       %{auto | standard_modes: %{"orbit" => "CIRCLE"}},
       {:deny, :mode, "from AUTO the mode may change to LOITER, RTL only, not to CIRCLE"}},
      {%{}, command("set_mode", %{standard_mode: "orbit"}), context(), :allow},
      # By whatever name.
      {modes, set.("MODE(1)"), %{context() | autopilot: :ardupilot, vehicle_type: "copter"},
       {:deny, :mode, "the mode ACRO is not allowed (modes.denied)"}},
      {%{modes: %{denied: ["HOLD"]}}, set.("auto_loiter"),
       %{context() | autopilot: :px4, vehicle_type: "copter"},
       {:deny, :mode, "the mode AUTO_LOITER is not allowed (modes.denied)"}}
    ])

    # Modes that hold the vehicle or bring it down are not kept waiting by a window.
    closed = %{windows: [%{types: ["set_mode"], days: [:mon], from: "08:00", to: "18:00"}]}

    for mode <- ["RTL", "land", "BRAKE", "AUTO_LOITER"],
        do: assert(Policy.decide(policy(closed), set.(mode), context()) == :allow)

    assert {:deny, :window, _} = Policy.decide(policy(closed), set.("GUIDED"), context())
    assert Policy.decide(policy(closed), command("set_mode", %{standard_mode: "land"}), context()) == :allow
  end

  test "altitude: above home and above mean sea level" do
    limits = %{max_altitude: 120.0, min_altitude: 10.0}
    msl = %{max_altitude_msl: 600}

    table([
      {limits, goto(47.0, 8.0, 120), context(), :allow},
      {limits, goto(47.0, 8.0, 120.5), context(),
       {:deny, :altitude, "the target is 120.5 m above home; at most 120 m is allowed"}},
      {limits, goto(47.0, 8.0, 9), context(),
       {:deny, :altitude, "the target is 9 m above home; at least 10 m is allowed"}},
      {limits, goto(47.0, 8.0, 621, "msl"), context(),
       {:deny, :altitude, "the target is 121 m above home; at most 120 m is allowed"}},
      {limits, goto(47.0, 8.0, 620, "msl"), context(), :allow},
      {limits, goto(47.0, 8.0, 620, "msl"), without(:home),
       {:deny, :altitude,
        "the target must be at most 120 m above home; how high it is, is not known, because the height of its home is not known"}},
      {limits, goto(47.0, 8.0, 20, "terrain"), context(),
       {:deny, :altitude,
        "the target must be at most 120 m above home; how high it is, is not known, because it is given above the ground"}},
      # The height above home needs nothing of the vehicle.
      {limits, command("takeoff", %{altitude: 150}), Context.new(%{}, @operator, @now),
       {:deny, :altitude, "the height to climb to is 150 m above home; at most 120 m is allowed"}},
      {limits, command("takeoff", %{altitude: 50}), Context.new(%{}, @operator, @now), :allow},
      {limits, command("set_altitude", %{altitude: 130}), context(),
       {:deny, :altitude, "the height to fly at is 130 m above home; at most 120 m is allowed"}},
      {limits, command("orbit", %{radius: 50, altitude: 130}), context(),
       {:deny, :altitude, "the circle is 130 m above home; at most 120 m is allowed"}},
      {limits, command("orbit", %{radius: 50}), context(), :allow},
      {limits, command("setpoint_position", %{lat: 47, lon: 8, altitude: 130}), context(),
       {:deny, :altitude, "the target is 130 m above home; at most 120 m is allowed"}},
      {limits, command("setpoint_local", %{north: 0, east: 0, down: -130}), context(),
       {:deny, :altitude, "the target is 130 m above home; at most 120 m is allowed"}},
      {limits, command("setpoint_velocity", %{vx: 0, vy: 0, vz: -35}), context(),
       {:deny, :altitude,
        "where that velocity leads before the vehicle stands is 195 m above home; at most 120 m is allowed"}},
      {limits, command("setpoint_velocity", %{vx: 0, vy: 0, vz: -5}), context(), :allow},
      # Who sets home higher would lift the limit.
      {limits, command("set_home", %{lat: 47, lon: 8, altitude_msl: 700}), context(%{}, @keeper),
       {:deny, :altitude, "the new home is 200 m above home; at most 120 m is allowed"}},
      {limits, command("set_home", %{lat: 47, lon: 8, altitude_msl: 500}), context(%{}, @keeper), :allow},
      {limits, command("land"), context(), :allow},
      {msl, goto(47.0, 8.0, 101), context(),
       {:deny, :altitude, "the target is 601 m above mean sea level; at most 600 m is allowed"}},
      {msl, goto(47.0, 8.0, 100), context(), :allow},
      {msl, goto(47.0, 8.0, 100), without(:home),
       {:deny, :altitude,
        "the target must be at most 600 m above mean sea level; how high it is, is not known, because the height of its home is not known"}}
    ])
  end

  test "geofence: targets, ways to them, circles, homes and set-points", %{fence: file} do
    fence = %{geofence_file: file}
    old = %{@vehicle | position: %{data: @vehicle.position, at: @now - 34_000_000}}

    table([
      {fence, goto(47.001, 8.019), context(), :allow},
      {fence, goto(47.03, 8.001), context(),
       {:deny, :geofence, ~s|the target 47.030000, 8.001000 is 1112 m outside the zone "field"|}},
      # The hole is in the middle of the way.
      {fence, goto(47.019, 8.019), context(),
       {:deny, :geofence, ~s|the straight way to the target (2424 m) leaves the zone "field" after 1078 m|}},
      {fence, goto(47.001, 8.019), without(:position),
       {:deny, :geofence, "a fence applies to goto, and the vehicle's position is not known"}},
      {fence, goto(47.001, 8.019), Context.new(old, @operator, @now),
       {:deny, :geofence, "a fence applies to goto, and the vehicle's last position is 34 s old"}},
      {fence, command("orbit", %{lat: 47.005, lon: 8.005, radius: 100}), context(), :allow},
      {fence, command("orbit", %{radius: 70}), context(), :allow},
      {fence, command("orbit", %{radius: 80}), context(),
       {:deny, :geofence, ~s|the circle 47.000875, 7.999960 is 3.0 m outside the zone "field"|}},
      {fence, command("takeoff", %{altitude: 50}), context(), :allow},
      {fence, command("takeoff", %{altitude: 50}), without(:position),
       {:deny, :geofence, "a fence applies to takeoff, and the vehicle's position is not known"}},
      {fence, command("takeoff", %{altitude: 50}), context(%{position: %{lat: 47.01, lon: 8.01}}),
       {:deny, :geofence, ~s|the height to climb to 47.010000, 8.010000 is 76 m outside the zone "field"|}},
      {fence, command("set_home", %{lat: 47.03, lon: 8.001, altitude_msl: 500}), context(%{}, @keeper),
       {:deny, :geofence, ~s|the new home 47.030000, 8.001000 is 1112 m outside the zone "field"|}},
      # Home may be anywhere inside, no way leads there.
      {fence, command("set_home", %{lat: 47.019, lon: 8.019, altitude_msl: 500}), context(%{}, @keeper),
       :allow},
      {fence, command("setpoint_position", %{lat: 47.03, lon: 8.001, altitude: 20}), context(),
       {:deny, :geofence, ~s|the target 47.030000, 8.001000 is 1112 m outside the zone "field"|}},
      {fence, command("setpoint_local", %{north: 50, east: 50, down: -20}), context(), :allow},
      {fence, command("setpoint_local", %{north: -150, east: 0, down: -20}), context(),
       {:deny, :geofence, ~s|the target 46.999653, 8.000500 is 39 m outside the zone "field"|}},
      {fence, command("setpoint_local", %{north: 5, east: 0, down: -20}), without(:home),
       {:deny, :geofence, "a fence applies to setpoint_local, and the vehicle's home is not known"}},
      # The border is 76 m to the west. 10 m/s are flown for 1 s by the gateway, 3 s more by the vehicle, and braking takes 33 m.
      {fence, command("setpoint_velocity", %{vx: 0, vy: -10, vz: 0}), context(),
       {:deny, :geofence,
        ~s|where that velocity leads before the vehicle stands 47.001000, 7.999902 is 7.4 m outside the zone "field"|}},
      {fence, command("setpoint_velocity", %{vx: 0, vy: -8, vz: 0}), context(), :allow},
      {fence, command("setpoint_velocity", %{vx: 0, vy: -8, vz: 0, hold: 6}), context(),
       {:deny, :geofence,
        ~s|where that velocity leads before the vehicle stands 47.001000, 7.999946 is 4.1 m outside the zone "field"|}},
      {fence, command("setpoint_velocity", %{vx: 30, vy: 0, vz: 0, frame: "body"}), context(), :allow},
      # Sideways and backwards its nose may turn, so it may go anywhere.
      {fence, command("setpoint_velocity", %{vx: 0, vy: 10, vz: 0, frame: "body"}), context(),
       {:deny, :geofence,
        ~s|where that velocity leads before the vehicle stands 47.000744, 7.999969 is 2.4 m outside the zone "field"|}},
      {fence, command("setpoint_attitude", %{roll: 0, pitch: 5, yaw: 0, thrust: 0.5}), context(),
       {:deny, :geofence, "a fence applies to setpoint_attitude, and where it leads, nobody can tell"}},
      {fence, command("setpoint_velocity", %{vx: 1, vy: 0, vz: 0, frame: "body"}),
       context(%{position: %{heading: nil}}),
       {:deny, :geofence, "a fence applies to setpoint_velocity, and the vehicle's heading is not known"}},
      {fence, command("set_altitude", %{altitude: 100}), context(), :allow},
      {fence, command("rtl"), without(:position), :allow},
      {fence, command("land"), without(:position), :allow}
    ])
  end

  test "a vehicle described in JSON, and what is wrong with the description" do
    json = %{
      "position" => %{"lat" => 47.001, "lon" => 8.001},
      "mode" => %{"armed" => true},
      "autopilot" => "px4",
      "at" => "2026-11-22T09:30:00Z"
    }

    assert {:ok, %Context{position: %{lat: 47.001, alt_rel: nil}, armed: true, home: nil, now: @now}} =
             Context.parse(json, @operator, 0)

    assert {:ok, %Context{position: nil}} = Context.parse(%{}, nil, 0)

    assert Context.parse(
             %{
               "position" => %{"lat" => "47", "alt" => 3},
               "mode" => %{"armed" => 1},
               "battery" => 4,
               "speed" => 3,
               "at" => "noon",
               "autopilot" => "x"
             },
             nil,
             0
           ) ==
             {:error,
              [
                "speed: expected one of position, home, mode, battery, autopilot, vehicle_type, at",
                "battery: expected an object",
                "mode.armed: expected true or false",
                "position.alt: expected one of alt_msl, alt_rel, heading, lat, lon",
                "at: expected a time such as 2026-11-22T10:00:00Z",
                "autopilot: expected one of ardupilot, betaflight, generic, inav, px4"
              ]}

    assert {:error, ["expected an object" <> _]} = Context.parse([], nil, 0)
  end

  test "a policy that contradicts itself is refused with all its errors, each with its key", %{fence: file} do
    assert {:error, errors} =
             Policy.compile(%{
               min_altitude: 100,
               max_altitude: 50,
               geofence_file: file <> ".no",
               modes: %{denied: ["ACRO"], transitions: %{"AUTO" => ["acro"]}},
               conditions: [%{types: ["reboot"]}, %{types: ["rebot"], armed: false}],
               windows: [
                 %{types: ["land"], from: "08:00", to: "18:00"},
                 %{from: "8", to: "25:00"},
                 %{from: "08:00", to: "08:00"}
               ],
               rates: [%{types: ["fly_away"]}]
             })

    assert errors == [
             "policy.min_altitude: expected less than max_altitude (50), got: 100",
             "policy.geofence_file: expected a fence, got: #{file}.no: no such file or directory",
             "policy.modes.transitions.AUTO: expected modes that may be asked for, got: ACRO, which modes.denied denies",
             "policy.conditions[0]: expected armed or in_air, got: neither",
             ~s|policy.conditions[1].types: expected names of commands (docs/commands.md lists them), got: rebot (did you mean "reboot"?)|,
             "policy.windows[0].types: expected commands that may wait, got: land, which holds a vehicle or brings it down",
             ~s|policy.windows[1].from: expected a time of day such as 06:30, UTC, got: 8|,
             ~s|policy.windows[1].to: expected a time of day such as 06:30, UTC, got: 25:00|,
             "policy.windows[2].to: expected another time than from, got: 08:00",
             ~s|policy.rates[0].types: expected names of commands (docs/commands.md lists them), got: fly_away|,
             "policy.rates[0].per_minute: expected a number, got: nothing"
           ]
  end

  test "any command gets a decision, whatever is known of the vehicle", %{fence: file} do
    section = %{
      geofence_file: file,
      max_altitude: 100,
      max_altitude_msl: 700,
      takeoff_battery: 0.2,
      modes: %{denied: ["ACRO"], transitions: %{"AUTO" => ["RTL"]}},
      windows: [%{from: "08:00", to: "18:00"}]
    }

    policy = policy(section)
    known = :proper_types.list(:proper_types.oneof(Map.keys(@vehicle)))

    property =
      :proper.forall({:proper_types.oneof(Command.Types.all()), known, :proper_types.integer()}, fn {type,
                                                                                                     known,
                                                                                                     seed} ->
        context = Context.new(Map.take(@vehicle, known), %{@operator | permissions: Roles.own()}, @now)

        case Command.parse(envelope(type, seed), @now) do
          {:ok, command} ->
            case Policy.decide(policy, command, context) do
              :allow -> true
              {:deny, rule, reason} -> rule in Policy.rules() and String.printable?(reason)
            end

          # The random parameters break one of the type's rules.
          {:error, _errors} ->
            true
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
  end

  defp envelope(type, seed) do
    state = :rand.seed_s(:exsss, seed)

    {params, _state} =
      Enum.flat_map_reduce(type.params, state, fn param, state ->
        {given, state} = :rand.uniform_s(state)
        {value, state} = value(param, state)
        {if(param.required or given < 0.6, do: [{Atom.to_string(param.name), value}], else: []), state}
      end)

    %{"id" => "a", "vehicle" => "v", "source" => "s", "type" => type.name, "params" => Map.new(params)}
  end

  defp value(%{type: :list} = param, state) do
    {item, state} = value(param.items, state)
    {[item], state}
  end

  defp value(param, state) do
    {share, state} = :rand.uniform_s(state)

    value =
      case param.type do
        :number -> param.min + share * (param.max - param.min)
        :integer -> round(param.min + share * (param.max - param.min))
        :boolean -> share > 0.5
        :choice -> Enum.at(param.values, trunc(share * length(param.values)))
        :text -> "GUIDED"
      end

    {value, state}
  end
end
