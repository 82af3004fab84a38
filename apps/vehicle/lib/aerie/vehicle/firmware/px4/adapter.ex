defmodule Aerie.Vehicle.Firmware.Px4.Adapter do
  @moduledoc """
  PX4, as of 1.17 and 1.18.

  Heights are above mean sea level in every command. Version 1.17 acknowledges DO_SET_MODE twice, the first time always with
  "accepted", and a mode that does not exist only with that, so the mode that it then shows counts. Some commands get no
  answer at all; the known ones are gaps here. On the ground PX4 accepts commands that it cannot carry out there, and before it is armed
  a take-off would wait for arming: both are refused here.
  """

  use Aerie.Vehicle.Firmware.Adapter

  use Aerie.Vehicle.Protocol.Mavlink.Commands,
    calibration: Aerie.Vehicle.Firmware.Px4.Calibration,
    long_frames: [0, 5]

  import Bitwise
  import Aerie.Vehicle.Protocol.Vehicle, only: [airborne: 2]

  alias Aerie.Vehicle.Firmware.{GroundStation, Modes, Px4, Reading, Telemetry, Traits}
  alias Aerie.Vehicle.Protocol.{Mavlink, Step, Vehicle}
  alias Aerie.Vehicle.Protocol.Mavlink.{Commands, Streams}
  alias Aerie.Vehicle.Firmware.Px4.{Calibration, Plans}
  alias MavCodec.Enums.MavAutopilot
  alias MavCodec.Messages, as: M

  @amsl 5
  @radians :math.pi() / 180
  # MAV_COMP_ID_CAMERA: the autopilot itself has no camera.
  @camera 100
  @winged ["plane", "vtol"]

  # ORBIT_YAW_BEHAVIOUR
  @orbit_yaw %{
    "center" => 0,
    "initial" => 1,
    "uncontrolled" => 2,
    "tangent" => 3,
    "rc" => 4,
    "unchanged" => 5
  }

  @impl true
  def traits do
    %Traits{
      title: "PX4",
      mav_autopilot: MavAutopilot.value(:MAV_AUTOPILOT_PX4),
      modes: Px4.Modes,
      inputs: Px4.Inputs,
      room: Px4.Room,
      param_encoding: :bytewise,
      param_hash?: true,
      fences?: true,
      any_zone?: true,
      setpoints_before_arming?: true
    }
  end

  @impl true
  def telemetry do
    %Telemetry{
      # Percent (input_rc.rssi, 0 to 100; -1 for unknown).
      rssi_full: 100,
      # -1 A, which it scales before sending it.
      unknown_current: -100,
      # The upper half of the mode has the main and the sub mode.
      high_latency_shift: 16,
      detects_landing?: true
    }
  end

  @impl true
  def reading do
    %Reading{
      keeps_nan?: true,
      long_height: :msl,
      ignores_frame?: true,
      zero_place: :there,
      guided_items: :stored,
      plan_whole?: true,
      mission_start_arms?: true,
      mode_in_bytes?: true,
      # Up to 1.11.
      safety_flag: :arms,
      setpoints: %{any: [:by_axis]},
      setpoint_timeout: {"COM_OF_LOSS_T", 1.0},
      steered_by: :commands
    }
  end

  @impl true
  def ground_station(_kind) do
    %GroundStation{
      listens_to: :any,
      enabled: ["NAV_DLL_ACT"],
      timeout: ["COM_DL_LOSS_T"],
      timeout_us: 10_000_000,
      asks: ~w(NAV_DLL_ACT COM_DL_LOSS_T)
    }
  end

  @impl true
  def gap(type, kind) when type in ["takeoff", "land"] and kind in ["rover", "boat", "sub"],
    do: "it does not fly"

  def gap(type, kind) when type in ["orbit", "set_yaw"] and kind in ["plane", "rover", "boat"],
    do: "only what can stay in one place does so"

  def gap("set_altitude", kind) when kind in ["rover", "boat"], do: "it has no height to change"

  def gap("vtol_transition", kind) when kind != "vtol",
    do: "it has no wings and rotors to change between"

  def gap("land_start", kind) when kind not in @winged, do: "only what has wings lands so"

  def gap("parachute", _kind),
    do: "PX4 opens a parachute by flight termination only: use terminate"

  def gap("servo", _kind), do: "PX4 has no DO_SET_SERVO: use actuator"
  def gap("relay", _kind), do: "PX4 has no relays"
  def gap("jump", _kind), do: "PX4 has no jump by tag: use mission_set_current"

  def gap("set_geofence", _kind),
    do: "PX4 has no DO_FENCE_ENABLE: its fence is on while the parameter GF_ACTION is not 0"

  def gap("calibrate_position", _kind), do: "PX4 finds out itself how it lies"
  def gap("calibrate_accept", _kind), do: "PX4 stores a calibration itself"
  def gap(_type, _kind), do: nil

  @impl true
  def steps(%{type: type, params: params}, vehicle) do
    case special(type, params, vehicle) do
      :common -> {:ok, type |> Commands.steps(params, vehicle) |> noted(type, vehicle)}
      {why_not, reason} -> {why_not, reason}
      steps -> {:ok, noted(steps, type, vehicle)}
    end
  end

  # They have to come before the mode (X7).
  defp noted(steps, "setpoint_" <> _what, %{mode: mode}) when mode not in [nil, "OFFBOARD"],
    do: Enum.map(steps, &%{&1 | note: "it is in #{mode}, and obeys set-points in OFFBOARD only"})

  defp noted(steps, _type, _vehicle), do: steps

  # COM_RC_IN_MODE: 0 a receiver only, 1 a joystick only, 4 no sticks at all.
  defp special("rc_override", _params, %{params: %{"COM_RC_IN_MODE" => mode}}) when mode in [1, 4],
    do: {:error, "its parameter COM_RC_IN_MODE is #{trunc(mode)}, so it takes no channels"}

  # It takes a channel that is left out before the last one as at its highest, fewer than four as a lost receiver, and
  # 0 as the lowest, so that it cannot
  # be given any back.
  defp special("rc_override", %{channels: channels} = params, vehicle) do
    given = channels |> Enum.reverse() |> Enum.drop_while(&(&1 == 0))

    if given != [] and (0 in given or length(given) < 4),
      do:
        {:error, "PX4 takes all channels up to the last one together: give each of them, and at least four"},
      else: for(step <- Commands.steps("rc_override", params, vehicle), do: put_in(step.stream.release, nil))
  end

  defp special("manual_control", _params, %{params: %{"COM_RC_IN_MODE" => mode}}) when mode in [0, 4],
    do: {:error, "its parameter COM_RC_IN_MODE is #{trunc(mode)}, so it takes no joystick"}

  # It would end a return or a mission, and fly to the height of take-off.
  defp special("takeoff", _params, %{in_air: true}), do: {:error, "it is in the air"}

  defp special("takeoff", _params, %{armed: armed}) when armed != true,
    do: {:error, "it is not armed, and PX4 would take off as soon as it is: arm it first"}

  defp special("takeoff", params, vehicle) do
    with {:ok, msl} <- Vehicle.msl(vehicle, params.altitude, "home") do
      here = %{4 => :nan, 5 => :nan, 6 => :nan, 7 => msl}
      [Mavlink.long(:MAV_CMD_NAV_TAKEOFF, here, confirm: {:in_air, true}, within_ms: 30_000)]
    end
  end

  # Without a position it descends instead.
  defp special("land", _params, _vehicle) do
    here = %{4 => :nan, 5 => :nan, 6 => :nan, 7 => :nan}

    [
      Mavlink.long(:MAV_CMD_NAV_LAND, here,
        confirm: {:any, [{:mode, ["AUTO_LAND", "AUTO_DESCEND"]}, {:in_air, false}]}
      )
    ]
  end

  defp special("rtl", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_NAV_RETURN_TO_LAUNCH, %{}, confirm: {:mode, ["AUTO_RTL"]})]

  defp special(type, _params, vehicle) when type in ["hold", "mission_pause"],
    do: mode("AUTO_LOITER", vehicle)

  # MISSION_START would arm it.
  defp special(type, _params, vehicle) when type in ["mission_start", "resume"],
    do: mode("AUTO_MISSION", vehicle)

  # DO_SET_MISSION_CURRENT is not supported.
  defp special("mission_set_current", params, _vehicle),
    do: [
      Mavlink.message(%M.MissionSetCurrent{seq: params.seq},
        confirm: {:mission_seq, params.seq},
        watch: :mission_current
      )
    ]

  defp special("set_mode", %{mode: name}, vehicle), do: mode(name, vehicle)

  defp special("set_mode", %{standard_mode: name}, vehicle) do
    case Modes.standard(vehicle) do
      %{^name => mode} -> mode(mode, vehicle)
      _none -> {:error, "PX4 has no mode for #{name}"}
    end
  end

  defp special("set_speed", %{kind: kind}, _vehicle) when kind in ["climb", "descent"],
    do:
      {:error,
       "PX4 has parameters for climbing and descending, and no command: MPC_Z_V_AUTO_UP, MPC_Z_V_AUTO_DN"}

  defp special("goto", params, vehicle) do
    with {:ok, msl} <- amsl(params, vehicle) do
      airborne(
        vehicle,
        reposition({params.lat, params.lon}, msl, %{1 => params[:speed] || -1, 4 => yaw(params)})
      )
    end
  end

  defp special("set_altitude", params, vehicle) do
    with {:ok, msl} <- amsl(params, vehicle), do: airborne(vehicle, reposition(nil, msl, %{4 => :nan}))
  end

  defp special("set_yaw", %{relative: true}, %{heading: nil}), do: {:error, "its heading is not known yet"}

  defp special("set_yaw", params, vehicle) do
    from = if params.relative, do: vehicle.heading, else: 0.0
    airborne(vehicle, reposition(nil, :nan, %{4 => wrap(from + params.yaw) * @radians}))
  end

  # A negative radius is counterclockwise.
  defp special("orbit", params, vehicle) do
    radius = if params.direction == "counterclockwise", do: -params.radius, else: params.radius

    numbers = %{
      1 => radius,
      2 => params[:speed] || :nan,
      3 => Map.fetch!(@orbit_yaw, params.yaw_behaviour)
    }

    with {:ok, z} <- optional_amsl(params, vehicle) do
      airborne(vehicle, [
        Mavlink.int(:MAV_CMD_DO_ORBIT, [{@amsl, z}], place(params), numbers,
          confirm: {:mode, ["POSCTL_ORBIT"]}
        )
      ])
    end
  end

  defp special("set_roi", params, vehicle) do
    with {:ok, msl} <- amsl(params, vehicle),
         do: [Mavlink.int(:MAV_CMD_DO_SET_ROI_LOCATION, [{@amsl, msl}], {params.lat, params.lon})]
  end

  # A gimbal obeys only its controller, so we take control first; -1 keeps the secondary controller.
  defp special("gimbal", params, %{us: {system, component}} = vehicle) do
    control = %{1 => system, 2 => component, 3 => -1, 4 => -1, 7 => params.gimbal}
    to = [component: Commands.gimbal_manager(params, vehicle)]
    configure = Mavlink.long(:MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, control, to)
    [configure | Commands.steps("gimbal", params, vehicle)]
  end

  defp special(type, params, vehicle) when type in ["camera_photo", "camera_video"],
    do: Commands.steps(type, Map.put_new(params, :component, @camera), vehicle)

  # NaN leaves an output as it is.
  defp special("actuator", params, _vehicle) do
    outputs = Map.new(1..6, &{&1, if(&1 == params.actuator, do: params.value, else: :nan)})
    [Mavlink.long(:MAV_CMD_DO_SET_ACTUATOR, outputs)]
  end

  # ACTUATOR_TEST with ACTUATOR_OUTPUT_FUNCTION_MOTOR1 and following.
  defp special("motor_test", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_ACTUATOR_TEST, %{1 => params.throttle, 2 => params.duration, 5 => params.motor})
    ]

  defp special("save_params", %{what: "mission"}, _vehicle),
    do: {:error, "PX4 stores a mission when it is written"}

  defp special("save_params", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_PREFLIGHT_STORAGE, %{1 => 1})]
  defp special("calibrate" <> _what = type, params, vehicle), do: Calibration.steps(type, params, vehicle)

  defp special("setpoint_position", params, vehicle) do
    with {:ok, msl} <- amsl(params, vehicle), do: Streams.position(params, @amsl, msl)
  end

  defp special(_type, _params, _vehicle), do: :common

  # Main and sub mode are separate parameters, not packed as in the heartbeat.
  defp mode(name, vehicle) do
    case Modes.find(vehicle, name) do
      {:ok, number, name} ->
        main = number >>> 16 &&& 0xFF
        sub = number >>> 24 &&& 0xFF
        [Mavlink.long(:MAV_CMD_DO_SET_MODE, %{1 => 1, 2 => main, 3 => sub}, confirm: {:mode, [name]})]

      :error ->
        {:error, "PX4 has no mode #{inspect(name)}"}
    end
  end

  # DO_REPOSITION that changes to Hold by itself; nil and NaN mean "unchanged".
  defp reposition(place, z, more) do
    numbers = Map.merge(%{1 => -1, 2 => 1}, more)
    [Mavlink.int(:MAV_CMD_DO_REPOSITION, [{@amsl, z}], place, numbers, confirm: {:mode, ["AUTO_LOITER"]})]
  end

  defp amsl(params, vehicle), do: Vehicle.msl(vehicle, params.altitude, params.altitude_reference)
  defp optional_amsl(%{altitude: _altitude} = params, vehicle), do: amsl(params, vehicle)
  defp optional_amsl(_params, _vehicle), do: {:ok, :nan}

  defp place(%{lat: lat, lon: lon}), do: {lat, lon}
  defp place(_nowhere), do: nil

  # In radians, as DO_REPOSITION has it.
  defp yaw(%{yaw: yaw}), do: wrap(yaw) * @radians
  defp yaw(_params), do: :nan

  defp wrap(degrees), do: :math.fmod(degrees + 900.0, 360.0) - 180.0

  @impl true
  # It acknowledges MISSION_SET_CURRENT by this text alone (MavlinkMissionManager::handle_mission_set_current).
  def read(
        %Step{watch: :mission_current},
        %M.Statustext{text: "WPM: WP CURR CMD:" <> _ = text},
        {system, _id},
        %{
          system: system
        }
      ),
      do: {:refused, :rejected, "the vehicle said: " <> text}

  def read(step, message, source, vehicle), do: super(step, message, source, vehicle)

  # A vehicle that is not armed takes every mode.
  @impl true
  def setpoints_first?(%{type: "set_mode", params: %{mode: name}}, %{armed: armed} = vehicle)
      when armed != false,
      do: match?({:ok, _number, "OFFBOARD"}, Modes.find(vehicle, name))

  def setpoints_first?(_command, _vehicle), do: false

  @impl true
  defdelegate kept(item, mission_type, kind), to: Px4.StoredItem, as: :item

  @impl true
  defdelegate plan_watch_us(mission_type), to: Plans, as: :watch_us

  @impl true
  defdelegate plan_verdict(message, mission_type, opaque_id), to: Plans, as: :verdict
end
