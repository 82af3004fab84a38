defmodule Aerie.Control.Policy.FirmwareReadingTest do
  @moduledoc "What an operator's raw MAVLink may make a vehicle do, as its firmware reads the numbers: each row once passed, or has a sibling that did."
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire, only: [decoded: 1]

  alias MavCodec.Meaning
  alias Aerie.Vehicle.Command.Types
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Mavlink}
  alias Aerie.Control.Policy.Intent.Context
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  @ap %{autopilot: :ardupilot, vehicle_type: "copter"}
  @px4 %{autopilot: :px4, vehicle_type: "copter"}
  @unknown %{autopilot: :generic, vehicle_type: "unknown"}
  @rover %{autopilot: :ardupilot, vehicle_type: "rover"}
  @operator %{name: "olga", role: :operator, permissions: []}
  # Who may move home in flight.
  @keeper %{@operator | permissions: [:protection]}
  @admin %{name: "ada", role: :admin, permissions: []}
  @now DateTime.to_unix(~U[2026-11-22 09:30:00Z], :microsecond)

  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.02, 47.0], [8.02, 47.02], [8.0, 47.02]]]}}
  """
  # Inside and far outside, in 1e-7 degrees.
  @lat 470_010_000
  @lon 80_010_000
  @far 475_000_000

  setup %{tmp_dir: dir} do
    file = Path.join(dir, "fence.geojson")
    File.write!(file, @fence)
    {:ok, section: %{geofence_file: file, max_altitude: 50, modes: %{denied: ["ACRO"]}}}
  end

  defp policy(section) do
    {:ok, policy} = Policy.compile(section)
    policy
  end

  defp context(vehicle, changes \\ %{}, source \\ @operator) do
    groups = %{
      position: %{lat: 47.001, lon: 8.001, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0},
      home: %{lat: 47.001, lon: 8.001, alt_msl: 500.0},
      mode: %{
        mode: if(vehicle.autopilot == :px4, do: "AUTO_LOITER", else: "LOITER"),
        armed: true,
        in_air: true
      },
      battery: %{remaining: 0.9}
    }

    groups = Map.merge(groups, changes, fn _group, known, changed -> Map.merge(known, changed) end)
    struct!(Context.new(groups, source, @now), vehicle)
  end

  defp judge(policy, message, vehicle, context),
    do: Policy.decide(policy, Mavlink.facts(decoded(message), vehicle), context)

  defp cmd(name), do: MavCmd.value(:"MAV_CMD_#{name}") || flunk("no command #{name}")

  defp long(name, params \\ []) do
    struct!(%M.CommandLong{command: if(is_integer(name), do: name, else: cmd(name))}, numbered(params))
  end

  defp int(name, params, more \\ []) do
    {floats, _rest} = params |> numbered() |> Keyword.split([:param1, :param2, :param3, :param4])
    struct!(%M.CommandInt{command: cmd(name)}, floats ++ more)
  end

  defp numbered(params), do: for({value, n} <- Enum.with_index(params, 1), do: {:"param#{n}", value(value)})
  defp value(value) when is_integer(value), do: value / 1
  defp value(value), do: value

  defp global(mask, fields \\ []),
    do:
      struct!(
        %M.SetPositionTargetGlobalInt{
          coordinate_frame: 6,
          type_mask: mask,
          lat_int: @lat,
          lon_int: @lon,
          alt: 20.0
        },
        fields
      )

  defp local(mask, fields),
    do: struct!(%M.SetPositionTargetLocalNed{coordinate_frame: 1, type_mask: mask, z: -20.0}, fields)

  defp refusals(section, rows, source \\ @operator) do
    policy = policy(section)

    for {rule, vehicle, message} <- rows do
      case judge(policy, message, vehicle, context(vehicle, %{}, source)) do
        {:deny, ^rule, reason} -> assert is_binary(reason)
        other -> flunk("#{inspect(message)}: #{inspect(other)}, not a refusal by #{rule}")
      end
    end
  end

  defp allowed(section, rows, source \\ @operator) do
    policy = policy(section)

    for {vehicle, message} <- rows,
        do:
          assert(
            {message, judge(policy, message, vehicle, context(vehicle, %{}, source))} == {message, :allow}
          )
  end

  test "arming and stopping the motors, by numbers that only look like something else", c do
    refusals(c.section, [
      {:role, @ap, long("COMPONENT_ARM_DISARM", [0, 21_196])},
      {:role, @px4, int("COMPONENT_ARM_DISARM", [0, 21_196])},
      {:role, @ap, long("COMPONENT_ARM_DISARM", [1, 2989])},
      {:role, @px4, long("COMPONENT_ARM_DISARM", [1, 21_196])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [0, 21_195.5])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [0, 21_195.6])},
      {:number, @px4, int("COMPONENT_ARM_DISARM", [0, 21_196.4])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [1, 21_195.6])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [0.6, 0])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [257, 0])},
      {:number, @px4, long("COMPONENT_ARM_DISARM", [-255, 0])},
      {:number, @ap, long("COMPONENT_ARM_DISARM", [0.99999994, 0])},
      {:number, @ap, long("COMPONENT_ARM_DISARM", [0, :infinity])},
      {:number, @ap, long("DO_PAUSE_CONTINUE", [0.9])},
      {:role, @ap, long("DO_FLIGHTTERMINATION", [1])},
      {:number, @px4, long("DO_FLIGHTTERMINATION", [0.51])},
      {:role, @ap, long("DO_PARACHUTE", [2])},
      {:number, @ap, long("DO_PARACHUTE", [1.99])}
    ])

    allowed(c.section, [
      {@ap, long("COMPONENT_ARM_DISARM", [1])},
      {@px4, long("COMPONENT_ARM_DISARM", [1, :nan, :nan, :nan, :nan, :nan, :nan])},
      {@ap, long("COMPONENT_ARM_DISARM")},
      {@px4, long("DO_PAUSE_CONTINUE", [1])}
    ])
  end

  test "what ends a flight or takes away a protection needs its own permission, whatever it is called", c do
    rows = [
      long("DO_AUX_FUNCTION", [31, 2]),
      long("DO_AUX_FUNCTION", [31, 0]),
      long("DO_AUX_FUNCTION", [22, 2]),
      long("DO_AUX_FUNCTION", [21, 0]),
      long("DO_AUX_FUNCTION", [23, 1]),
      long("DO_AUX_FUNCTION", [41, 0]),
      long("DO_AUX_FUNCTION", [153, 0]),
      long("DO_AUX_FUNCTION", [81, 2]),
      long("DO_AUX_FUNCTION", [165, 1]),
      long("DO_AUX_FUNCTION", [32, 0]),
      long("DO_AUX_FUNCTION", [179, 0]),
      long("DO_AUX_FUNCTION", [11, 0]),
      long("DO_AUX_FUNCTION", [11, 1]),
      long("DO_AUX_FUNCTION", [40, 0]),
      long("DO_AUX_FUNCTION", [100, 2]),
      long("DO_AUX_FUNCTION", [300, 2]),
      long("DO_AUX_FUNCTION", [999, 2]),
      long("DO_SET_SAFETY_SWITCH_STATE", [0]),
      long("DO_SET_SAFETY_SWITCH_STATE", [1]),
      %M.SetMode{base_mode: 128, custom_mode: 1},
      %M.SetMode{base_mode: 128, custom_mode: 0},
      long("DO_SET_MODE", [128, 1]),
      long("DO_ENGINE_CONTROL", [0]),
      long("INJECT_FAILURE", [101, 1, 0]),
      long("CONFIGURE_ACTUATOR", [3, 0, 0, 0, 1]),
      long("ACTUATOR_TEST", [1, 3, 0, 0, 1]),
      long("ACTUATOR_GROUP_TEST", [0, 1]),
      long("DO_SET_PARAMETER", [7, 0]),
      long("PREFLIGHT_STORAGE", [2]),
      long("PREFLIGHT_STORAGE", [0, 2]),
      long("PREFLIGHT_STORAGE_ADVANCED"),
      long("DO_FENCE_ENABLE", [0]),
      long("DO_FENCE_ENABLE", [2]),
      long("ESTIMATOR_SENSOR_ENABLE", [0, 0, 0]),
      long("BATTERY_RESET", [255, 100]),
      long("DEBUG_TRAP", [32_451]),
      long("PRS_SHUTDOWN"),
      %M.MissionClearAll{mission_type: 1},
      %M.MissionClearAll{mission_type: 255},
      %M.MissionCount{mission_type: 1, count: 0},
      %M.FencePoint{idx: 0, count: 0, lat: 47.001, lng: 8.001},
      %M.ParamSet{param_id: "FENCE_ENABLE"},
      %M.ParamSet{param_id: "WPNAV_SPEED"}
    ]

    refusals(c.section, for(message <- rows, do: {:role, @ap, message}))
    # PX4's mode that ends the flight.
    refusals(c.section, [{:role, @px4, %M.SetMode{base_mode: 1, custom_mode: Bitwise.bsl(10, 16)}}])

    allowed(c.section, [
      {@ap, long("DO_AUX_FUNCTION", [9, 2])},
      {@ap, long("DO_AUX_FUNCTION", [28, 0])},
      {@ap, long("DO_AUX_FUNCTION", [4, 2])},
      {@ap, long("DO_AUX_FUNCTION", [153, 2])},
      {@ap, long("DO_AUX_FUNCTION", [11, 2])},
      {@ap, long("DO_FENCE_ENABLE", [1])},
      {@ap, long("DO_ENGINE_CONTROL", [1])},
      {@ap, %M.MissionClearAll{}},
      {@ap, %M.MissionCount{mission_type: 1, count: 4}}
    ])

    # An admin may maintain and take away protections, but end no flight.
    allowed(
      c.section,
      for(
        message <- [
          long("INJECT_FAILURE", [101, 1, 0]),
          long("DO_FENCE_ENABLE", [0]),
          long("DO_SET_PARAMETER", [7, 0]),
          long("DO_SET_SAFETY_SWITCH_STATE", [1]),
          %M.ParamSet{param_id: "FENCE_ENABLE"},
          %M.MissionClearAll{mission_type: 255}
        ],
        do: {@ap, message}
      ),
      @admin
    )

    policy = policy(c.section)

    for message <- [
          long("DO_AUX_FUNCTION", [31, 2]),
          long("DO_AUX_FUNCTION", [22, 2]),
          long("DO_SET_SAFETY_SWITCH_STATE", [0]),
          long("DO_ENGINE_CONTROL", [0]),
          long("DEBUG_TRAP", [32_451]),
          %M.SetMode{base_mode: 128, custom_mode: 1}
        ],
        do: assert({:deny, :role, _} = judge(policy, message, @ap, context(@ap, %{}, @admin)))
  end

  test "a vehicle that has not said what it is needs what any firmware would need" do
    sticks = %M.ManualControl{target: 1, x: 0, y: 0, z: 500, r: 0}
    alone = Map.new(1..8, &{:"chan#{&1}_raw", 65_535})

    channels =
      struct!(%M.RcChannelsOverride{target_system: 1, target_component: 1}, %{alone | chan3_raw: 1600})

    for {permission, message} <- [
          {:receiver, long("COMPONENT_ARM_DISARM", [1])},
          {:receiver, %M.SetMode{base_mode: 1, custom_mode: 1}},
          {:receiver, sticks},
          {:receiver, channels},
          {:motors, long("DO_MOTOR_TEST", [1, 0, 10, 1])}
        ],
        known <- [@unknown, %{autopilot: :betaflight, vehicle_type: "copter"}] do
      # A motor test needs `maintain` besides.
      for source <- if(permission == :motors, do: [@admin], else: [@operator, @admin]) do
        assert {:deny, :role, reason} = judge(policy(%{}), message, known, context(known, %{}, source))
        assert reason =~ "needs the permission #{permission}"
      end
    end

    # What brings it home is not kept from it; of a Betaflight that works its pilot's channels.
    home = long("NAV_RETURN_TO_LAUNCH", [])
    betaflight = %{autopilot: :betaflight, vehicle_type: "copter"}
    assert :allow = judge(policy(%{}), home, @unknown, context(@unknown, %{}, @operator))
    assert {:deny, :role, _why} = judge(policy(%{}), home, betaflight, context(betaflight, %{}, @operator))

    # To disarm it needs no more than anywhere.
    disarm = long("COMPONENT_ARM_DISARM", [0])
    assert :allow = judge(policy(%{}), disarm, @unknown, context(@unknown, %{mode: %{in_air: false}}))
  end

  test "modes are those that the firmware makes of the numbers", c do
    acro = Bitwise.bsl(5, 16)

    refusals(c.section, [
      {:mode, @ap, %M.SetMode{base_mode: 1, custom_mode: 1}},
      {:number, @ap, %M.SetMode{base_mode: 1, custom_mode: 257}},
      {:number, @ap, long("DO_SET_MODE", [1, 257])},
      {:number, @ap, long("DO_SET_MODE", [1, 1.5])},
      {:number, @ap, long("DO_SET_MODE", [1.5, 4])},
      {:number, @ap, long("DO_SET_MODE", [257, 4])},
      {:mode, @px4, %M.SetMode{base_mode: 1, custom_mode: acro}},
      {:number, @px4, %M.SetMode{base_mode: 1, custom_mode: acro + 1}},
      {:number, @px4, long("DO_SET_MODE", [1, 261])},
      {:number, @px4, long("DO_SET_MODE", [1, 4, 259])},
      {:mode, @px4, long("DO_SET_MODE", [1, 5, 9])},
      {:mode, @px4, %M.SetMode{base_mode: 1, custom_mode: acro + Bitwise.bsl(7, 24)}},
      # Without a name.
      {:mode, @ap, %M.SetMode{base_mode: 1, custom_mode: 200}},
      {:mode, @px4, long("DO_SET_MODE", [1, 99])},
      {:mode, @px4, long("DO_SET_STANDARD_MODE", [0])},
      {:number, @px4, long("DO_SET_STANDARD_MODE", [264])},
      {:mode, @ap, long("DO_AUX_FUNCTION", [52, 2])},
      # Back to the mode of a switch, which may be any.
      {:mode, @ap, long("DO_AUX_FUNCTION", [52, 0])}
    ])

    # It may be any firmware, so the channels' permission is needed before the mode is looked at.
    refusals(
      c.section,
      [
        {:mode, @unknown, %M.SetMode{base_mode: 1, custom_mode: 1}},
        {:mode, @unknown, %M.SetMode{base_mode: 5, custom_mode: 1}}
      ],
      %{@operator | permissions: [:receiver]}
    )

    allowed(c.section, [
      {@ap, %M.SetMode{base_mode: 1, custom_mode: 4}},
      {@ap, long("DO_SET_MODE", [1, 6])},
      {@px4, long("DO_SET_MODE", [129, 4, 3])},
      {@px4, long("DO_SET_MODE", [1, 4])},
      {@px4, long("DO_SET_MODE", [29, 4, 4])}
    ])

    # Without the flag, PX4 goes by the others.
    assert {:deny, :mode, reason} =
             judge(
               policy(%{modes: %{denied: ["MANUAL"]}}),
               %M.SetMode{base_mode: 64, custom_mode: Bitwise.bsl(4, 16) + Bitwise.bsl(3, 24)},
               @px4,
               context(@px4)
             )

    assert reason =~ "MANUAL"

    # The sub mode of an orbit cannot be asked for so: it is position control.
    orbit = long("DO_SET_MODE", [1, 3, 1])
    assert {:deny, :mode, _} = judge(policy(%{modes: %{denied: ["POSCTL"]}}), orbit, @px4, context(@px4))

    # Where nothing is denied, a mode may have any name.
    assert judge(policy(%{}), %M.SetMode{base_mode: 1, custom_mode: 200}, @ap, context(@ap)) == :allow

    # A mode that the vehicle has told is known, and may be denied.
    told = %{context(@ap) | mode_names: %{200 => "Script"}}
    script = %M.SetMode{base_mode: 1, custom_mode: 200}
    assert judge(policy(c.section), script, @ap, told) == :allow
    assert {:deny, :mode, _} = judge(policy(%{modes: %{denied: ["MODE(200)"]}}), script, @ap, told)
  end

  test "places are judged in whatever command or set-point they are", c do
    outside = [x: @far, y: @lon, z: 20.0, frame: 3]
    msl = [x: @far, y: @lon, z: 510.0, frame: 0]

    refusals(
      c.section,
      [
        {:geofence, @ap, int("DO_SET_HOME", [], msl)},
        {:altitude, @ap, int("DO_SET_HOME", [], x: @lat, y: @lon, z: 400.0, frame: 3)}
      ],
      @keeper
    )

    refusals(c.section, [
      {:geofence, @ap, int("DO_REPOSITION", [], outside)},
      {:geofence, @px4, int("NAV_VTOL_TAKEOFF", [], msl)},
      {:geofence, @px4, int("NAV_TAKEOFF", [], msl)},
      {:geofence, @px4, long("NAV_TAKEOFF", [0, 0, 0, 0, 47.5, 8.001, 510])},
      {:geofence, @px4, long("NAV_TAKEOFF", [0, 0, 0, 0, 0, 0, 510])},
      {:geofence, @ap, int("OVERRIDE_GOTO", [0, 3], outside)},
      {:geofence, @ap, int("OVERRIDE_GOTO", [1, 3], outside)},
      {:geofence, @px4, int("DO_ORBIT", [50, 5], msl)},
      {:geofence, @ap, int("NAV_WAYPOINT", [], outside)},
      {:geofence, @ap, int("DO_FIGURE_EIGHT", [], outside)},
      {:geofence, @ap, int("PAYLOAD_PREPARE_DEPLOY", [], outside)},
      {:altitude, @ap, long("DO_FOLLOW", [7])},
      {:altitude, @ap, long("GUIDED_CHANGE_HEADING", [0, 90])},
      {:altitude, @ap, int("GUIDED_CHANGE_ALTITUDE", [], z: 500.0, frame: 3)},
      {:altitude, @ap, long("SOLO_BTN_FLY_HOLD", [10])},
      {:altitude, @px4, long("DO_GO_AROUND", [500])},
      {:altitude, @ap, long("DO_RALLY_LAND", [500])},
      # Beyond the ends of latitudes.
      {:geofence, @ap, long("DO_REPOSITION", [0, 0, 0, 0, 132.999, -171.999, 20])},
      # One coordinate is 0 if it is NaN.
      {:geofence, @ap, long("DO_REPOSITION", [0, 0, 0, 0, :nan, 8.001, 20])},
      {:geofence, @ap, int("DO_REPOSITION", [], x: 0x7FFFFFFF, y: @lon, z: 20.0, frame: 3)},
      # Rovers drive by speed and direction.
      {:geofence, @rover, long("NAV_SET_YAW_SPEED", [180, 60, 0])},
      {:geofence, @ap, global(0xDF8, lat_int: @far)},
      {:geofence, @ap, global(0xDF9, lat_int: @far)},
      {:geofence, @px4, global(0xDF9, lon_int: 90_000_000)},
      {:geofence, @ap, local(0xDF8, x: 9000.0)},
      {:geofence, @px4, local(0xDF9, x: 0.0, y: 9000.0)},
      {:geofence, @ap, local(0xDC7, vx: 800.0)},
      {:geofence, @ap, local(0xDC3, vx: 800.0)},
      {:geofence, @px4, local(0xDC4, x: 0.0, vx: 800.0)},
      {:altitude, @ap, local(0xC3F, afx: 5.0)},
      {:altitude, @ap, local(0xC3B, afx: 5.0)},
      {:altitude, @ap, global(0xC3F, afx: 5.0)},
      {:altitude, @px4, local(0xDFB, z: -200.0)},
      {:altitude, @ap, local(0xDF8, coordinate_frame: 21, x: 1.0)},
      {:geofence, @ap, %M.MissionItemInt{current: 2, frame: 3, command: 16, x: @far, y: @lon, z: 20.0}},
      {:geofence, @ap, %M.MissionItem{current: 2, frame: 3, command: 16, x: 47.5, y: 8.001, z: 20.0}},
      {:geofence, @ap, %M.MissionItemInt{current: 2, frame: 3, command: 178, x: @far, y: @lon, z: 20.0}},
      {:number, @ap,
       %M.MissionItemInt{current: 2, frame: 3, command: 178, x: @far, y: @lon, z: 20.0, mission_type: 1}}
    ])

    allowed(c.section, [
      {@ap, int("DO_REPOSITION", [-1, 1, 0, :nan], x: @lat + 10_000, y: @lon, z: 20.0, frame: 6)},
      {@px4, long("NAV_TAKEOFF", [-1, :nan, :nan, :nan, :nan, :nan, :nan])},
      {@ap, long("NAV_TAKEOFF", [0, 0, 0, 0, 0, 0, 20])},
      {@ap, int("OVERRIDE_GOTO", [0, 2], outside)},
      {@px4, long("DO_GO_AROUND", [0])},
      {@ap, global(0xDF8)},
      {@px4, local(0xDC0, x: 10.0, vx: 1.0)},
      {@px4, local(0xDE3, z: -20.0, vx: 1.0)},
      {@ap, local(0xDC7, vx: 3.0)},
      {@ap, local(0xDFF, yaw: 1.0)},
      {@rover, long("NAV_SET_YAW_SPEED", [0, 3, 0])}
    ])

    # By acceleration alone it may go where there is no limit.
    assert judge(policy(%{}), local(0xC3F, afx: 5.0), @ap, context(@ap)) == :allow
  end

  test "PX4 takes heights as above mean sea level, whatever the frame says", c do
    low = %{home: %{alt_msl: -300.0}, position: %{alt_msl: -280.0}}
    goto = int("DO_REPOSITION", [-1, 1], x: @lat, y: @lon, z: 40.0, frame: 3)
    assert {:deny, :altitude, _} = judge(policy(c.section), goto, @px4, context(@px4, low))
    assert judge(policy(c.section), goto, @ap, context(@ap, low)) == :allow
    climb = long("DO_CHANGE_ALTITUDE", [40, 3])
    assert {:deny, :altitude, _} = judge(policy(c.section), climb, @px4, context(@px4, low))
  end

  defp item(command, fields \\ []) do
    command = if is_integer(command), do: command, else: cmd(command)
    struct!(%M.MissionItemInt{frame: 3, command: command, x: @lat, y: @lon, z: 20.0}, fields)
  end

  defp upload(policy, items, vehicle, context) do
    messages = [
      %M.MissionCount{count: length(items)} | for({item, n} <- Enum.with_index(items), do: %{item | seq: n})
    ]

    {decisions, _last} =
      Enum.map_reduce(messages, nil, fn message, last ->
        message = decoded(message)
        {facts, last} = Mavlink.Upload.next(last, message, Mavlink.facts(message, vehicle))
        {Policy.decide(policy, facts, context), last}
      end)

    Enum.find(decisions, :allow, &(&1 != :allow))
  end

  test "items of a mission are judged by the same rows as commands", c do
    policy = policy(c.section)
    nowhere = [x: 0, y: 0, z: 0.0]

    for {rule, item} <- [
          role: item("DO_PARACHUTE", [param1: 2.0] ++ nowhere),
          number: item("DO_PARACHUTE", [param1: 2.4] ++ nowhere),
          role: item("DO_FLIGHTTERMINATION", [param1: 1.0] ++ nowhere),
          role: item("DO_AUX_FUNCTION", [param1: 31.0, param2: 2.0] ++ nowhere),
          role: item("DO_AUX_FUNCTION", [param1: 11.0, param2: 0.0] ++ nowhere),
          role: item("NAV_SCRIPT_TIME", nowhere),
          role: item("DO_SEND_SCRIPT_MESSAGE", nowhere),
          role: item("DO_SET_PARAMETER", [param1: 7.0] ++ nowhere),
          role: item("DO_FENCE_ENABLE", nowhere),
          role: item("DO_ENGINE_CONTROL", nowhere),
          role: item("INJECT_FAILURE", [param1: 101.0, param2: 1.0] ++ nowhere),
          unknown: item(43_999, nowhere),
          altitude: item("NAV_CONTINUE_AND_CHANGE_ALT", param1: 1.0, x: 0, y: 0, z: 500.0),
          altitude: item("CONDITION_CHANGE_ALT", param1: 1.0, x: 0, y: 0, z: 500.0),
          altitude: item("DO_CHANGE_ALTITUDE", [param1: 500.0, param2: 3.0] ++ nowhere),
          altitude: item("NAV_LOITER_TO_ALT", z: 500.0),
          altitude: item("NAV_WAYPOINT", z: 500.0),
          altitude: item("NAV_TAKEOFF", x: 0, y: 0, z: 500.0),
          altitude: item("NAV_ATTITUDE_TIME", nowhere),
          altitude: item("DO_GO_AROUND", [param1: 500.0] ++ nowhere),
          altitude: item("NAV_FOLLOW", nowhere),
          altitude: item("NAV_SET_YAW_SPEED", [param2: 5.0] ++ nowhere),
          geofence: item("NAV_WAYPOINT", x: @far),
          geofence: item("NAV_TAKEOFF", x: @far),
          geofence: item("NAV_VTOL_TAKEOFF", x: @far),
          role: item("DO_SET_HOME", z: 0.0),
          geofence: item("DO_LAND_START", x: @far),
          geofence: item("DO_RETURN_PATH_START", x: @far),
          geofence: item("DO_REPOSITION", x: @far),
          geofence: item("OVERRIDE_GOTO", param1: 1.0, x: @far),
          geofence: item("DO_ORBIT", param1: 20.0, x: @far),
          geofence: item("SET_GUIDED_SUBMODE_CIRCLE", x: @far),
          geofence: item("NAV_LOITER_TURNS", param1: 2.0, param3: 5000.0),
          geofence: item("NAV_LOITER_TIME", param1: 2.0, param3: -5000.0, x: 0, y: 0),
          geofence: item("DO_FIGURE_EIGHT", param1: 5000.0)
        ] do
      for vehicle <- [@ap, @px4] do
        decision =
          upload(policy, [item("NAV_WAYPOINT"), item("NAV_WAYPOINT"), item], vehicle, context(vehicle))

        assert match?({:deny, ^rule, _reason}, decision), inspect({item, vehicle, decision})
      end
    end

    # A home that is higher lifts the limit.
    for {rule, item} <- [
          geofence: item("DO_SET_HOME", x: @far, z: 0.0),
          altitude: item("DO_SET_HOME", z: 400.0)
        ],
        vehicle <- [@ap, @px4],
        do:
          assert(
            {:deny, ^rule, _reason} =
              upload(policy, [item("NAV_WAYPOINT"), item], vehicle, context(vehicle, %{}, @keeper))
          )

    for {vehicle, acro} <- [{@ap, 1.0}, {@px4, 5.0}] do
      item = item("DO_SET_MODE", [param1: 1.0, param2: acro] ++ nowhere)
      assert {:deny, :mode, _reason} = upload(policy, [item("NAV_WAYPOINT"), item], vehicle, context(vehicle))
    end

    # PX4 flies to its first item, too.
    assert {:deny, :geofence, _} = upload(policy, [item("NAV_WAYPOINT", x: @far)], @px4, context(@px4))

    usual = [
      item("NAV_WAYPOINT"),
      item("NAV_TAKEOFF", x: 0, y: 0),
      item("NAV_WAYPOINT", x: @lat + 10_000),
      item("DO_CHANGE_SPEED", [param1: 1.0, param2: 5.0, param3: -1.0] ++ nowhere),
      item("DO_SET_CAM_TRIGG_DIST", [param1: 20.0, param3: 1.0] ++ nowhere),
      item("IMAGE_START_CAPTURE", [param2: 2.0, param3: 1.0] ++ nowhere),
      item("DO_SET_ROI_LOCATION", x: @far),
      item("DO_MOUNT_CONTROL", [param1: -90.0] ++ nowhere),
      item("DO_SET_SERVO", [param1: 9.0, param2: 1500.0] ++ nowhere),
      item("CONDITION_YAW", [param1: 90.0, param3: 1.0] ++ nowhere),
      item("NAV_DELAY", [param1: 3.0, param2: -1.0, param3: -1.0, param4: -1.0] ++ nowhere),
      item("NAV_SPLINE_WAYPOINT"),
      item("NAV_LOITER_TURNS", param1: 2.0),
      item("NAV_CONTINUE_AND_CHANGE_ALT", param1: 1.0, x: 0, y: 0, z: 40.0),
      item("DO_JUMP", [param1: 2.0, param2: -1.0] ++ nowhere),
      item("DO_LAND_START", nowhere),
      item("DO_FENCE_ENABLE", [param1: 1.0] ++ nowhere),
      item("DO_GRIPPER", [param1: 1.0] ++ nowhere),
      item("NAV_RETURN_TO_LAUNCH", nowhere)
    ]

    assert upload(policy, usual, @ap, context(@ap)) == :allow
    # To PX4, 0, 0 is a place.
    assert {:deny, :geofence, _reason} = upload(policy, usual, @px4, context(@px4))
    usual = List.replace_at(usual, 1, item("NAV_TAKEOFF"))
    assert upload(policy, usual, @px4, context(@px4)) == :allow
  end

  test "a command that is new is refused, until an admin opens it", c do
    for id <- [1, 5555, 43_999, 60_000] do
      message = long(id)
      assert {:deny, :unknown, reason} = judge(policy(c.section), message, @ap, context(@ap))
      assert reason =~ "#{id}"
      assert {:deny, :unknown, _} = judge(policy(c.section), message, @ap, context(@ap, %{}, @admin))
      opened = policy(Map.put(c.section, :open, [%{command: id}]))
      assert {:deny, :role, _} = judge(opened, message, @ap, context(@ap))
      assert judge(opened, message, @ap, context(@ap, %{}, @admin)) == :allow
      all = policy(Map.put(c.section, :unknown, :maintain))
      assert {:deny, :role, _} = judge(all, message, @ap, context(@ap))
      assert judge(all, message, @ap, context(@ap, %{}, @admin)) == :allow
    end

    assert {:deny, :unknown, _} =
             Policy.decide(policy(%{}), Mavlink.unknown(16_000_000), context(@ap, %{}, @admin))

    opened = policy(%{open: [%{message: 16_000_000}]})
    assert Policy.decide(opened, Mavlink.unknown(16_000_000), context(@ap, %{}, @admin)) == :allow

    assert {:error,
            [
              "policy.open[0].command: expected a command that the gateway does not know, got: 400 (COMPONENT_ARM_DISARM)"
            ]} =
             Policy.compile(%{open: [%{command: 400}]})

    assert {:error, ["policy.open[0]: expected either command or message, got: both"]} =
             Policy.compile(%{open: [%{command: 1, message: 60_000}]})

    assert {:error, ["policy.open[0]: expected command or message, got: neither"]} =
             Policy.compile(%{open: [%{command: nil}]})
  end

  test "every way to leave the ground is a take-off: charge, windows and conditions hold for it" do
    ground = %{mode: %{in_air: false}, battery: %{remaining: 0.1}}
    night = %{windows: [%{types: ["takeoff"], days: [:mon], from: "08:00", to: "18:00"}]}

    ways = [
      {@ap, long("NAV_TAKEOFF", [0, 0, 0, 0, 0, 0, 20])},
      {@ap, int("NAV_TAKEOFF", [], x: @lat, y: @lon, z: 20.0, frame: 3)},
      {@ap, long("NAV_VTOL_TAKEOFF", [0, 0, 0, 0, 0, 0, 20])},
      {@ap, long("MISSION_START")},
      {@ap, long("DO_PAUSE_CONTINUE", [1])},
      {@ap, long("OVERRIDE_GOTO", [1, 2])},
      {@ap, long("DO_SET_MISSION_CURRENT", [1])},
      {@ap, %M.MissionSetCurrent{seq: 1}},
      {@ap, long("DO_JUMP", [1])},
      {@ap, long("DO_JUMP_TAG", [1])},
      {@ap, long("DO_LAND_START")},
      {@ap, %M.SetMode{base_mode: 1, custom_mode: 3}},
      {@ap, %M.SetMode{base_mode: 1, custom_mode: 4}},
      {@ap, long("DO_SET_MODE", [1, 3])},
      {@px4, long("DO_SET_MODE", [1, 4, 4])},
      {@px4, long("DO_SET_MODE", [1, 4])},
      {@px4, long("DO_SET_MODE", [1, 4, 2])},
      {@px4, long("DO_SET_MODE", [1, 6])},
      {@px4, long("DO_SET_STANDARD_MODE", [6])},
      {@px4, long("DO_SET_STANDARD_MODE", [8])},
      {@ap, long("DO_AUX_FUNCTION", [16, 2])},
      {@ap, long("DO_AUX_FUNCTION", [77, 2])},
      {@ap, long("SOLO_BTN_FLY_HOLD", [5])},
      {@ap, long("NAV_WAYPOINT", [0, 0, 0, 0, 47.001, 8.001, 5])},
      {@ap, int("DO_REPOSITION", [], x: @lat, y: @lon, z: 20.0, frame: 3)},
      {@ap, %M.MissionItemInt{current: 2, frame: 3, command: 16, x: @lat, y: @lon, z: 20.0}}
    ]

    for {vehicle, message} <- ways do
      here = context(vehicle, ground)

      assert {:deny, :battery, _} = judge(policy(%{takeoff_battery: 0.3}), message, vehicle, here),
             inspect(message)

      assert {:deny, :window, _} = judge(policy(night), message, vehicle, here), inspect(message)

      conditions = %{conditions: [%{types: ["takeoff"], armed: false, in_air: nil}]}
      assert {:deny, :condition, _} = judge(policy(conditions), message, vehicle, here), inspect(message)
    end

    # What arms.
    for {vehicle, message} <- [
          {@ap, long("COMPONENT_ARM_DISARM", [1])},
          {@ap, long("DO_AUX_FUNCTION", [153, 2])},
          {@px4, long("MISSION_START")},
          {@px4, long("DO_SET_MODE", [129, 4, 3])}
        ] do
      here = context(vehicle, ground)

      assert {:deny, :battery, _} = judge(policy(%{takeoff_battery: 0.3}), message, vehicle, here),
             inspect(message)

      windows = %{windows: [%{types: ["arm"], days: [:mon], from: "08:00", to: "18:00"}]}
      assert {:deny, :window, _} = judge(policy(windows), message, vehicle, here), inspect(message)
    end

    # In the air none of it is a take-off, and a rover never takes off.
    for {vehicle, message} <- ways,
        message.__struct__ != M.CommandLong or message.command not in [22, 84, 42_002],
        message.__struct__ != M.CommandInt or message.command != 22 do
      here = context(vehicle, %{ground | mode: %{in_air: true}})
      assert judge(policy(%{takeoff_battery: 0.3}), message, vehicle, here) == :allow, inspect(message)
      assert judge(policy(night), message, vehicle, here) == :allow
    end

    drive = int("DO_REPOSITION", [], x: @lat, y: @lon, z: 0.0, frame: 3)
    assert judge(policy(%{takeoff_battery: 0.3}), drive, @rover, context(@rover, ground)) == :allow
  end

  test "a command of MAV_CMD belongs to one type at most, and needs the same permission" do
    for %{mav_cmds: names, permission: permission} = type <- Types.all(), name <- names do
      row = Meaning.Commands.get(MavCmd.value(:"MAV_CMD_#{name}"))
      assert {name, row.permission, Types.name_of_mav_cmd(row.id)} == {name, permission, type.name}
    end

    for row <- Meaning.Commands.all(),
        do: assert(row.permission in Aerie.Vehicle.Command.Type.permissions())
  end

  test "ground stations' usual questions and commands are an operator's", c do
    questions = for %{class: :question} = row <- Meaning.Commands.all(), do: {@ap, long(row.id, [1])}

    allowed(
      c.section,
      questions ++
        [
          {@ap, long("SET_MESSAGE_INTERVAL", [33, 1.0e6 / 30])},
          {@ap, long("REQUEST_MESSAGE", [148, 0, 0, 0, 0, 0, 0])},
          {@px4, long("REQUEST_MESSAGE", [148, :nan, :nan, :nan, :nan, :nan, :nan])},
          {@ap, long("NAV_RETURN_TO_LAUNCH")},
          {@ap, long("NAV_LAND")},
          {@ap, long("DO_CHANGE_SPEED", [1, 5.5, -1])},
          {@ap, long("CONDITION_YAW", [90, 10, 1, 0])},
          {@ap, long("DO_MOUNT_CONTROL", [-45, 0, 10, 0, 0, 0, 2])},
          {@ap, long("DO_GIMBAL_MANAGER_PITCHYAW", [-45, :nan, :nan, :nan, 0, 0, 0])},
          {@ap, long("IMAGE_START_CAPTURE", [0, 0, 1, 0])},
          {@ap, long("VIDEO_START_CAPTURE", [0, 1])},
          {@ap, long("SET_CAMERA_ZOOM", [2, 50])},
          {@ap, long("DO_SET_SERVO", [9, 1500])},
          {@ap, long("DO_SET_ROI_LOCATION", [0, 0, 0, 0, 47.5, 8.5, 400])},
          {@ap, long("EXTERNAL_POSITION_ESTIMATE", [0, 0, 1, 0, 47.001, 8.001, :nan])},
          {@ap, long("RUN_PREARM_CHECKS")}
        ]
    )
  end

  # What PX4 and ArduPilot make of a float that should be an integer.
  defp readings(value) do
    Enum.uniq([
      trunc(value),
      round(value),
      floor(value),
      ceil(value),
      Integer.mod(trunc(value), 256),
      Integer.mod(round(value), 256)
    ])
  end

  test "no number that a firmware may read as a refused one is allowed", c do
    policy = policy(c.section)
    commands = for row <- Meaning.Commands.all(), {index, _kind} <- row.numbers, do: {row, index}

    float =
      :proper_types.oneof([
        :proper_types.integer(-70_000, 70_000),
        :proper_types.float(-300.0, 300.0),
        :proper_types.oneof([21_195.5, 21_196.4, 21_196, 2989, 2988.6, 0.6, 0.99999994, 257, 256.5, 65_567])
      ])

    property =
      :proper.forall({:proper_types.oneof(commands), float}, fn {{row, index}, value} ->
        message = &long(row.id, List.replace_at(List.duplicate(0, 7), index - 1, &1))

        for vehicle <- [@ap, @px4], judge(policy, message.(value), vehicle, context(vehicle)) == :allow do
          read = decoded(message.(value)) |> Map.fetch!(:"param#{index}")

          for reading <- readings(read) do
            decision = judge(policy, message.(reading), vehicle, context(vehicle))

            # A reading that is out of its range is nothing that the firmware obeys.
            if decision != :allow and elem(decision, 1) != :number,
              do:
                flunk(
                  "#{row.name}: parameter #{index} is #{value}, which may be read as #{reading}: #{inspect(decision)}"
                )
          end
        end

        true
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2000]) == true, inspect(:proper.counterexample())
  end

  test "parameters and files that protect a vehicle need the permission for it, by every way" do
    maintainer = %{@operator | permissions: [:maintain]}
    allowed? = fn facts -> Policy.decide(policy(%{}), facts, context(@ap, %{}, maintainer)) == :allow end
    set = &Mavlink.facts(decoded(%M.ParamSet{param_id: &1}), @ap)

    for name <-
          ~w(FENCE_ENABLE fence_enable FENCE_ALT_MAX AVOID_ENABLE ARMING_CHECK ARMING_SKIPCHK BRD_SAFETYENABLE FS_THR_ENABLE FS_GCS_ENABL
          BATT_FS_LOW_ACT BATT2_FS_CRT_ACT BATT_LOW_VOLT THR_FAILSAFE AFS_ENABLE CHUTE_ENABLED RC7_OPTION GF_ACTION GF_MAX_VER_DIST
          COM_OBL_RC_ACT COM_LOW_BAT_ACT COM_RCL_EXCEPT COM_ARM_WO_GPS COM_DISARM_PRFLT NAV_DLL_ACT NAV_RCL_ACT CBRK_SUPPLY_CHK CBRK_FLIGHTTERM
          CP_DIST FD_FAIL_P BAT_CRIT_THR RC_MAP_KILL_SW SYSID_MYGCS) do
      refute allowed?.(set.(name)), name
      refute allowed?.(Intent.set_parameters(["WPNAV_SPEED", name])), name
      refute allowed?.(Mavlink.facts(decoded(%M.ParamMapRc{param_id: name, param_index: -1}), @ap)), name
      refute allowed?.(Mavlink.facts(decoded(%M.ParamExtSet{param_id: name}), @ap)), name
    end

    for name <- ~w(WPNAV_SPEED MPC_XY_VEL_MAX RTL_ALT CAM_EXPOSURE ATC_RAT_RLL_P SERVO9_MIN PFENCE OFS_THR),
        do: assert(allowed?.(set.(name)), name)

    # By its number, and not by its name.
    refute allowed?.(Mavlink.facts(decoded(%M.ParamMapRc{param_id: "WPNAV_SPEED", param_index: 0}), @ap))

    ftp = fn operation, data ->
      payload = <<7::16-little, 0, operation, byte_size(data), 0::24, 0::32, data::binary>>

      Mavlink.facts(
        decoded(%M.FileTransferProtocol{payload: payload <> :binary.copy(<<0>>, 251 - byte_size(payload))}),
        @ap
      )
    end

    for path <- [
          "@PARAM/param.pck",
          "@MISSION/fence.dat",
          "/fs/microsd/dataman",
          "/fs/microsd/params",
          "APM/scripts/a.lua",
          "/fs/microsd/etc/extras.txt"
        ],
        operation <- [6, 8, 11, 12, 13] do
      refute allowed?.(ftp.(operation, path)), inspect({operation, path})
      refute allowed?.(Intent.write_file(path))
    end

    refute allowed?.(ftp.(13, "/a.txt" <> <<0>> <> "@PARAM/param.pck"))
    for operation <- [6, 8, 11], do: assert(allowed?.(ftp.(operation, "/fs/microsd/log/notes.txt")))
    assert allowed?.(ftp.(7, "any bytes of a param"))
  end
end
