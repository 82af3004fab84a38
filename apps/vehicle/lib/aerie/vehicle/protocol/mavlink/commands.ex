defmodule Aerie.Vehicle.Protocol.Mavlink.Commands do
  @moduledoc """
  Commands that are the same for ArduPilot and PX4: the steps made of their parameters. `use` it in the adapter of a firmware for the callbacks
  that are the same in both; `:calibration` is the module of its calibrations, `:long_frames` those that heights in COMMAND_LONG refer to.
  """

  alias Aerie.Vehicle.Protocol.{Mavlink, Step}
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @forced 21_196
  @speeds %{"airspeed" => 0, "groundspeed" => 1, "climb" => 2, "descent" => 3}
  @reboots %{"normal" => 1, "bootloader" => 3}
  # RC_TYPE and RC_SUB_TYPE
  @receivers %{"dsm2" => {0, 0}, "dsmx" => {0, 1}, "dsmx8" => {0, 2}, "crsf" => {1, 0}}
  # GIMBAL_MANAGER_FLAGS
  @gimbal_retract 1
  @gimbal_neutral 2
  @gimbal_lock_to_north 16 + 64
  @gimbal_to_vehicle 32
  @second_us 1_000_000
  # PREFLIGHT_CALIBRATION: the parameter of a sensor, and its value.
  @preflight %{
    "gyro" => {1, 1},
    "magnetometer" => {2, 1},
    "barometer" => {3, 1},
    "rc" => {4, 1},
    "accelerometer" => {5, 1},
    "level" => {5, 2},
    "accelerometer_simple" => {5, 4},
    "compass_motor" => {6, 1},
    "airspeed" => {6, 2},
    "esc" => {7, 1}
  }

  @doc false
  defmacro __using__(calibration: calibration, long_frames: frames) do
    quote do
      @impl true
      defdelegate encode(step, attempt, vehicle), to: Mavlink
      @impl true
      defdelegate cancel(step, vehicle), to: Mavlink
      @impl true
      defdelegate release(step, vehicle), to: Mavlink
      @impl true
      def read(step, message, source, vehicle),
        do: unquote(__MODULE__).read(step, message, source, vehicle, unquote(calibration), unquote(frames))

      @impl true
      def listens(step), do: unquote(__MODULE__).listens(step) ++ unquote(calibration).listens(step)

      defoverridable read: 4
    end
  end

  @doc "The steps of a command; nil for one that differs between the firmwares."
  @spec steps(String.t(), map(), Aerie.Vehicle.Protocol.Vehicle.t()) :: [Step.t()] | nil
  def steps("arm", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_COMPONENT_ARM_DISARM, %{1 => 1}, confirm: {:armed, true})]

  def steps("disarm", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_COMPONENT_ARM_DISARM, %{1 => 0}, confirm: {:armed, false})]

  def steps("force_disarm", _params, _vehicle),
    # It does not wait for an answer to arm or disarm.
    do: [
      Mavlink.long(:MAV_CMD_COMPONENT_ARM_DISARM, %{1 => 0, 2 => @forced},
        urgent?: true,
        confirm: {:armed, false}
      )
    ]

  def steps("terminate", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_FLIGHTTERMINATION, %{1 => 1})]
  def steps("prearm_check", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_RUN_PREARM_CHECKS)]
  def steps("clear_roi", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_SET_ROI_NONE)]
  def steps("land_start", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_LAND_START)]

  def steps("set_speed", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_DO_CHANGE_SPEED, %{
        1 => Map.fetch!(@speeds, params.kind),
        2 => params.speed,
        3 => -1
      })
    ]

  def steps("set_home", %{here: true}, vehicle) do
    # The vehicle knows its position better than we do, so some distance is allowed.
    confirm = if vehicle.lat && vehicle.lon, do: {:home, vehicle.lat, vehicle.lon, 30}
    [Mavlink.long(:MAV_CMD_DO_SET_HOME, %{1 => 1}, confirm: confirm, within_ms: 6_000)]
  end

  def steps("set_home", %{lat: lat, lon: lon, altitude_msl: altitude}, _vehicle),
    do: [
      Mavlink.int(:MAV_CMD_DO_SET_HOME, [{5, altitude}], {lat, lon}, %{},
        confirm: {:home, lat, lon, 2},
        within_ms: 6_000
      )
    ]

  def steps("set_origin", params, _vehicle) do
    message = %M.SetGpsGlobalOrigin{
      latitude: round(params.lat * 1.0e7),
      longitude: round(params.lon * 1.0e7),
      altitude: round(params.altitude_msl * 1000)
    }

    [Mavlink.message(message, confirm: :told, watch: {:message, M.GpsGlobalOrigin.id()}, within_ms: 3_000)]
  end

  def steps("vtol_transition", params, _vehicle) do
    {state, label} = if params.to == "fixed_wing", do: {4, "FW"}, else: {3, "MC"}

    [
      Mavlink.long(:MAV_CMD_DO_VTOL_TRANSITION, %{1 => state},
        confirm: {:vtol_state, label},
        within_ms: 60_000
      )
    ]
  end

  def steps("gripper", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_DO_GRIPPER, %{
        1 => params.gripper,
        2 => if(params.action == "grab", do: 1, else: 0)
      })
    ]

  def steps("camera_trigger", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_DIGICAM_CONTROL, %{5 => 1})]

  def steps("camera_trigger_distance", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_DO_SET_CAM_TRIGG_DIST, %{1 => params.distance})]

  def steps("camera_photo", %{action: "stop"} = params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_IMAGE_STOP_CAPTURE, %{}, component: params[:component])]

  def steps("camera_photo", params, _vehicle) do
    [
      Mavlink.long(:MAV_CMD_IMAGE_START_CAPTURE, %{2 => params.interval, 3 => params.count},
        component: params[:component],
        cancel: {:long, MavCmd.value(:MAV_CMD_IMAGE_STOP_CAPTURE), [0, :nan, :nan, :nan, 0, 0, :nan]}
      )
    ]
  end

  def steps("camera_video", %{action: "start"} = params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_VIDEO_START_CAPTURE, %{1 => params.stream}, component: params[:component])]

  def steps("camera_video", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_VIDEO_STOP_CAPTURE, %{1 => params.stream}, component: params[:component])]

  def steps("gimbal", params, vehicle) do
    point = %{1 => params[:pitch] || :nan, 2 => params[:yaw] || :nan, 3 => :nan, 4 => :nan}

    [
      Mavlink.long(
        :MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
        Map.merge(point, %{5 => gimbal_flags(params), 7 => params.gimbal}),
        component: gimbal_manager(params, vehicle)
      )
    ]
  end

  def steps("reboot", params, vehicle) do
    [
      Mavlink.long(:MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, %{1 => Map.fetch!(@reboots, params.to)},
        # A vehicle in its boot loader is not heard.
        confirm: if(params.to == "normal", do: {:booted, vehicle.boots}),
        within_ms: 60_000
      )
    ]
  end

  def steps("reset_params", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_PREFLIGHT_STORAGE, %{1 => 2})]

  def steps("rx_pair", params, _vehicle) do
    {type, kind} = Map.fetch!(@receivers, params.receiver)
    [Mavlink.long(:MAV_CMD_START_RX_PAIR, %{1 => type, 2 => kind})]
  end

  def steps("request_message", params, _vehicle) do
    # A requested COMMAND_ACK could not be distinguished from any command's acknowledgement.
    seen? = params.message_id != M.CommandAck.id()

    [
      Mavlink.long(:MAV_CMD_REQUEST_MESSAGE, %{1 => params.message_id, 2 => params.index},
        component: params[:component],
        # The session asks the autopilot as well, which may be named here.
        shared?: params[:component] in [nil, 1],
        confirm: if(seen?, do: :told),
        watch: if(seen?, do: {:message, params.message_id})
      )
    ]
  end

  def steps("set_message_interval", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_SET_MESSAGE_INTERVAL, %{1 => params.message_id, 2 => interval(params)},
        shared?: true
      )
    ]

  # REQUEST_OPERATOR_CONTROL (X15): only for a vehicle that reports who controls it.
  def steps("take_control", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_REQUEST_OPERATOR_CONTROL, %{1 => 1, 2 => 0})]

  def steps("hand_over_control", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_REQUEST_OPERATOR_CONTROL, %{1 => 1, 2 => 1})]

  def steps("release_control", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_REQUEST_OPERATOR_CONTROL, %{1 => 0})]

  def steps("high_latency", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_CONTROL_HIGH_LATENCY, %{1 => if(params.enabled, do: 1, else: 0)})]

  def steps(type, params, vehicle), do: Mavlink.Streams.steps(type, params, vehicle)

  defp interval(%{rate: rate}), do: round(@second_us / rate)
  defp interval(%{action: "stop"}), do: -1
  defp interval(%{action: "default"}), do: 0

  @doc "The component that gets a gimbal's commands: the one that says that it manages gimbals; nil: the autopilot."
  @spec gimbal_manager(map(), Aerie.Vehicle.Protocol.Vehicle.t()) :: 1..255 | nil
  def gimbal_manager(params, vehicle) do
    component = params[:component] || vehicle.gimbal_manager
    if component != vehicle.component, do: component
  end

  defp gimbal_flags(%{action: "retract"}), do: @gimbal_retract
  defp gimbal_flags(%{action: "neutral"}), do: @gimbal_neutral
  defp gimbal_flags(%{yaw_reference: "north"}), do: @gimbal_lock_to_north
  defp gimbal_flags(_vehicle), do: @gimbal_to_vehicle

  @doc "The step that calibrates a sensor. The adapter knows which sensors its firmware calibrates this way."
  @spec preflight(String.t(), keyword()) :: Step.t()
  def preflight(sensor, options) do
    {index, value} = Map.fetch!(@preflight, sensor)
    Mavlink.long(:MAV_CMD_PREFLIGHT_CALIBRATION, %{index => value}, options)
  end

  @doc """
  What a message says about a step: the firmware's texts and reports about a calibration, an acknowledgement, or the message that was
  requested. `calibration` is the firmware's module, `long_frames` are the frames that heights in COMMAND_LONG refer to.
  """
  @spec read(
          Step.t(),
          struct(),
          Aerie.Vehicle.Protocol.source(),
          Aerie.Vehicle.Protocol.Vehicle.t(),
          module(),
          [non_neg_integer()]
        ) :: Aerie.Vehicle.Protocol.answer()
  def read(step, message, source, vehicle, calibration, long_frames) do
    with :ignore <- calibration.read(step, message, source, vehicle),
         :ignore <- Mavlink.read(step, message, source, vehicle, long_frames) do
      if told?(step, message, source, vehicle), do: :done, else: :ignore
    end
  end

  # The first frame of a requested message ends the step.
  defp told?(%Step{watch: {:message, id}} = step, %module{}, source, vehicle),
    do: module.id() == id and source == {vehicle.system, step.component || vehicle.component}

  defp told?(_step, _message, _source, _vehicle), do: false

  @doc "The ids of the messages that `read/6` wants."
  @spec listens(Step.t()) :: [non_neg_integer()]
  def listens(step), do: Mavlink.listens(step) ++ watched(step)

  defp watched(%Step{watch: {:message, id}}), do: [id]
  defp watched(_step), do: []
end
