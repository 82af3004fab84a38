defmodule Aerie.Policy.Raw.Commands do
  @moduledoc "COMMAND_LONG and COMMAND_INT: which command of the table each command of MAV_CMD is, and where it leads."

  import Bitwise

  alias Aerie.Policy.Facts
  alias Aerie.Policy.Raw.Place
  alias Aerie.Protocol.Modes
  alias MavCodec.Enums.{MavCmd, MavStandardMode}
  alias MavCodec.Messages, as: M

  id = fn name -> MavCmd.value(:"MAV_CMD_#{name}") || raise("no command #{name}") end

  # Those that mean the same whatever their parameters are.
  @plain Map.new(
           [
             {"land", ~w(NAV_LAND NAV_VTOL_LAND NAV_LAND_LOCAL)},
             {"rtl", ~w(NAV_RETURN_TO_LAUNCH)},
             {"land_start", ~w(DO_LAND_START)},
             {"mission_start", ~w(MISSION_START)},
             {"mission_set_current", ~w(DO_SET_MISSION_CURRENT)},
             {"jump", ~w(DO_JUMP DO_JUMP_TAG)},
             {"set_speed", ~w(DO_CHANGE_SPEED)},
             {"set_yaw", ~w(CONDITION_YAW)},
             {"set_roi", ~w(DO_SET_ROI DO_SET_ROI_LOCATION DO_SET_ROI_WPNEXT_OFFSET DO_SET_ROI_SYSID)},
             {"clear_roi", ~w(DO_SET_ROI_NONE)},
             {"vtol_transition", ~w(DO_VTOL_TRANSITION)},
             {"gripper", ~w(DO_GRIPPER)},
             {"servo", ~w(DO_SET_SERVO DO_REPEAT_SERVO DO_SET_ACTUATOR)},
             {"relay", ~w(DO_SET_RELAY DO_REPEAT_RELAY)},
             {"camera_photo",
              ~w(IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE DO_DIGICAM_CONTROL DO_DIGICAM_CONFIGURE)},
             {"camera_video", ~w(VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE)},
             {"camera_trigger", ~w(DO_TRIGGER_CONTROL SET_CAMERA_MODE SET_CAMERA_ZOOM SET_CAMERA_FOCUS)},
             {"camera_trigger_distance", ~w(DO_SET_CAM_TRIGG_DIST)},
             {"gimbal",
              ~w(DO_MOUNT_CONTROL DO_MOUNT_CONFIGURE DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE)},
             {"motor_test", ~w(DO_MOTOR_TEST ACTUATOR_TEST)},
             {"calibrate",
              ~w(PREFLIGHT_CALIBRATION PREFLIGHT_SET_SENSOR_OFFSETS DO_START_MAG_CAL FIXED_MAG_CAL_YAW)},
             {"reboot", ~w(PREFLIGHT_REBOOT_SHUTDOWN)},
             {"save_params", ~w(PREFLIGHT_STORAGE)},
             {"prearm_check", ~w(RUN_PREARM_CHECKS)},
             {"rx_pair", ~w(START_RX_PAIR)},
             {"set_geofence", ~w(DO_FENCE_ENABLE)},
             {"set_message_interval", ~w(SET_MESSAGE_INTERVAL)},
             {"request_message", ~w(REQUEST_MESSAGE)},
             {"high_latency", ~w(CONTROL_HIGH_LATENCY)}
           ]
           |> Enum.flat_map(fn {type, names} -> Enum.map(names, &{id.(&1), type}) end)
         )

  @arm id.("COMPONENT_ARM_DISARM")
  # What makes it disarm in flight, or arm without its checks.
  @force [21_196, 2989]
  @takeoff Enum.map(~w(NAV_TAKEOFF NAV_VTOL_TAKEOFF NAV_TAKEOFF_LOCAL), id)
  @reposition id.("DO_REPOSITION")
  @orbit id.("DO_ORBIT")
  @set_mode id.("DO_SET_MODE")
  @standard_mode id.("DO_SET_STANDARD_MODE")
  @altitude id.("DO_CHANGE_ALTITUDE")
  @set_home id.("DO_SET_HOME")
  @pause id.("DO_PAUSE_CONTINUE")
  @override id.("OVERRIDE_GOTO")
  @parachute id.("DO_PARACHUTE")
  @terminate id.("DO_FLIGHTTERMINATION")
  @control id.("REQUEST_OPERATOR_CONTROL")

  # Of missions: those without a place of their own among the NAV commands, and those with one beyond.
  @nav 16..95
  @no_place Enum.map(
              ~w(NAV_RETURN_TO_LAUNCH NAV_CONTINUE_AND_CHANGE_ALT NAV_LAST NAV_DELAY NAV_GUIDED_ENABLE),
              id
            )
  # Behind them vendors have commands of their own.
  @last_own 30_999

  @doc "Whether a mission item of this command is a place to which the vehicle flies."
  @spec place?(non_neg_integer()) :: boolean()
  def place?(command), do: command in @nav and command not in @no_place

  @doc "The facts of a command."
  @spec facts(struct(), Aerie.Policy.Raw.vehicle()) :: Facts.t()
  def facts(%{command: command}, _vehicle) when is_map_key(@plain, command), do: Facts.named(@plain[command])

  def facts(%{command: @arm} = m, _vehicle) do
    cond do
      m.param1 == 1 and trunc(Place.number(m.param2)) in @force -> Facts.named("arm", permission: :maintain)
      m.param1 == 1 -> Facts.named("arm")
      trunc(Place.number(m.param2)) in @force -> Facts.named("force_disarm")
      true -> Facts.named("disarm")
    end
  end

  def facts(%{command: command} = m, vehicle) when command in @takeoff do
    place = %{place(m, vehicle) | lat: nil, lon: nil}
    Facts.named("takeoff", path: {:to, [place]}, what: "the height to climb to")
  end

  def facts(%{command: @reposition} = m, vehicle), do: Facts.named("goto", path: to(m, vehicle))

  def facts(%{command: @orbit, param1: radius} = m, vehicle),
    do: Facts.named("orbit", path: {:around, place(m, vehicle), Place.number(radius)}, what: "the circle")

  def facts(%{command: @set_mode} = m, %{autopilot: autopilot, vehicle_type: kind}) do
    [base, main, sub] = for value <- [m.param1, m.param2, m.param3], do: trunc(Place.number(value))
    custom = if autopilot == :px4, do: bsl(main, 16) ||| bsl(sub, 24), else: main
    Facts.named("set_mode", mode: Modes.name(autopilot, kind, base, custom))
  end

  def facts(%{command: @standard_mode, param1: mode}, _vehicle) do
    name =
      case MavStandardMode.name(trunc(Place.number(mode))) do
        nil ->
          "#{mode}"

        name ->
          name |> Atom.to_string() |> String.replace_prefix("MAV_STANDARD_MODE_", "") |> String.downcase()
      end

    Facts.named("set_mode", standard_mode: name)
  end

  def facts(%{command: @altitude, param1: metres, param2: frame}, _vehicle) do
    height = Place.height(trunc(Place.number(frame)), metres)

    Facts.named("set_altitude",
      path: {:to, [%{lat: nil, lon: nil, height: height}]},
      what: "the height to fly at"
    )
  end

  def facts(%{command: @set_home} = m, vehicle) do
    here = %{lat: nil, lon: nil, height: :same}
    place = if m.param1 == 1, do: here, else: above_sea(place(m, vehicle))
    Facts.named("set_home", path: {:at, [place]}, what: "the new home")
  end

  def facts(%{command: @pause, param1: go_on}, _vehicle),
    do: Facts.named(if(go_on == 1, do: "resume", else: "mission_pause"))

  def facts(%{command: @override, param1: action}, _vehicle) when action == 0, do: Facts.named("hold")
  def facts(%{command: @override} = m, vehicle), do: Facts.named("goto", path: to(m, vehicle))

  def facts(%{command: @parachute, param1: action}, _vehicle),
    do: Facts.named("parachute", ends_flight?: action == 2)

  # A station that is refused may ask the one in charge to offer it (X15).
  def facts(%{command: @control, param1: action}, _vehicle) when action == 0,
    do: Facts.named("release_control", control: :release)

  def facts(%{command: @control, param2: allow}, _vehicle),
    do: Facts.named("take_control", control: {:take, nil, if(allow == 1, do: :anyone)})

  # 0 ends the termination, which is no less of a decision.
  def facts(%{command: @terminate}, _vehicle), do: Facts.named("terminate")

  def facts(%{command: command} = m, vehicle) do
    %Facts{
      type: "mav_cmd_#{command}",
      permission: if(command <= @last_own, do: :fly, else: :maintain),
      moves?: true,
      path: if(place?(command), do: to(m, vehicle), else: :none)
    }
  end

  defp to(m, vehicle) do
    case m do
      %M.CommandInt{frame: 1} -> Place.local(1, {m.x / 1.0e4, m.y / 1.0e4, m.z})
      _global -> {:to, [place(m, vehicle)]}
    end
  end

  defp place(%M.CommandInt{} = m, _vehicle), do: Place.of(m)

  # COMMAND_LONG has no frame: PX4 takes its height above mean sea level, ArduPilot above home.
  defp place(%M.CommandLong{param5: lat, param6: lon, param7: metres}, vehicle) do
    height =
      cond do
        not is_number(metres) -> :same
        vehicle.autopilot == :px4 -> {:msl, metres}
        true -> {:home, metres}
      end

    %{lat: Place.finite(lat), lon: Place.finite(lon), height: height}
  end

  # In whatever frame: a home's height is above mean sea level.
  defp above_sea(%{height: {:home, metres}} = place), do: %{place | height: {:msl, metres}}
  defp above_sea(place), do: place
end
