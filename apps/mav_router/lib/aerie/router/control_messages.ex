defmodule Aerie.Router.ControlMessages do
  @moduledoc """
  Which messages change a vehicle, in one table: everything that a vehicle obeys, stores or believes. Questions do not, nor does
  what a sender says of itself (ADSB_VEHICLE, FOLLOW_TARGET, COLLISION, GLOBAL_POSITION_INT).

  | kind | |
  |---|---|
  | `:command` | commands, modes, set-points and sticks, writes of parameters, missions, fences and files, keys, consoles, rates |
  | `:input` | what estimators, clocks, flow control and safety functions believe, from any sender: external positions, GPS corrections, ranges, simulated sensors, RADIO_STATUS |
  | `:presence` | a heartbeat that a vehicle may take for that of its ground station |
  | nil | everything else |

  MISSION_COUNT, MISSION_ITEM and FILE_TRANSFER_PROTOCOL go both ways: to a vehicle they write, from a vehicle they answer. So the
  target decides as well, which `Aerie.Router.CommandGate` looks at.

  A message that the gateway does not know (R4) is none of these. A test lists the messages with a target that are not here, so that
  somebody decides about each new one.
  """

  alias Aerie.Mavlink.Heartbeat
  alias Aerie.Mavlink.Message
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Enums.MavType
  alias MavCodec.Frame

  @commands ~w(COMMAND_LONG COMMAND_INT COMMAND_CANCEL COMMAND_LONG_STAMPED COMMAND_INT_STAMPED SET_MODE
    CHANGE_OPERATOR_CONTROL AUTH_KEY AIRLINK_AUTH SETUP_SIGNING SECURE_COMMAND
    MANUAL_CONTROL MANUAL_SETPOINT RC_CHANNELS_OVERRIDE RC_CHANNELS_OVERRIDE_V2 RADIO_RC_CHANNELS CUBEPILOT_RAW_RC
    ASL_OBCTRL SET_ATTITUDE_TARGET
    SET_POSITION_TARGET_LOCAL_NED SET_POSITION_TARGET_GLOBAL_INT SET_ACTUATOR_CONTROL_TARGET SET_VELOCITY_LIMITS
    TRAJECTORY_REPRESENTATION_WAYPOINTS TRAJECTORY_REPRESENTATION_BEZIER
    SET_HOME_POSITION SET_GPS_GLOBAL_ORIGIN SET_MAG_OFFSETS SAFETY_SET_ALLOWED_AREA
    PARAM_SET PARAM_EXT_SET PARAM_MAP_RC
    MISSION_COUNT MISSION_ITEM MISSION_ITEM_INT MISSION_WRITE_PARTIAL_LIST MISSION_CLEAR_ALL MISSION_SET_CURRENT
    FENCE_POINT RALLY_POINT
    FILE_TRANSFER_PROTOCOL LOG_ERASE SERIAL_CONTROL TUNNEL V2_EXTENSION DEVICE_OP_READ DEVICE_OP_WRITE
    CAN_FRAME CANFD_FRAME CAN_FILTER_MODIFY DATA16 DATA32 DATA64 DATA96
    GIMBAL_CONTROL GIMBAL_DEVICE_SET_ATTITUDE GIMBAL_MANAGER_SET_ATTITUDE GIMBAL_MANAGER_SET_PITCHYAW
    GIMBAL_MANAGER_SET_MANUAL_CONTROL MOUNT_CONTROL MOUNT_CONFIGURE DIGICAM_CONTROL DIGICAM_CONFIGURE
    STORM32_GIMBAL_MANAGER_CONTROL STORM32_GIMBAL_MANAGER_CONTROL_PITCHYAW STORM32_GIMBAL_MANAGER_CORRECT_ROLL
    GOPRO_SET_REQUEST LED_CONTROL LED_STRIP_CONFIG PLAY_TUNE PLAY_TUNE_V2 OSD_PARAM_CONFIG REQUEST_DATA_STREAM
    WIFI_CONFIG_AP CELLULAR_CONFIG ESC_EEPROM CUBEPILOT_FIRMWARE_UPDATE_START REMOTE_LOG_BLOCK_STATUS
    UAVIONIX_ADSB_OUT_CFG UAVIONIX_ADSB_OUT_CFG_REGISTRATION UAVIONIX_ADSB_OUT_CFG_FLIGHTID UAVIONIX_ADSB_OUT_CONTROL)

  @inputs ~w(GPS_INPUT GPS_INJECT_DATA GPS_RTCM_DATA VISION_POSITION_ESTIMATE VISION_SPEED_ESTIMATE
    VISION_POSITION_DELTA GLOBAL_POSITION_SENSOR GLOBAL_VISION_POSITION_ESTIMATE VICON_POSITION_ESTIMATE ATT_POS_MOCAP ODOMETRY OPTICAL_FLOW OPTICAL_FLOW_RAD
    DISTANCE_SENSOR OBSTACLE_DISTANCE OBSTACLE_DISTANCE_3D LANDING_TARGET TARGET_RELATIVE TARGET_ABSOLUTE RANGING_BEACON
    TERRAIN_DATA SYSTEM_TIME RADIO_STATUS RADIO MLRS_RADIO_LINK_STATS MLRS_RADIO_LINK_FLOW_CONTROL
    AUTOPILOT_STATE_FOR_GIMBAL_DEVICE AUTOPILOT_STATE_FOR_GIMBAL_DEVICE_EXT UAVIONIX_ADSB_OUT_DYNAMIC
    HIL_SENSOR HIL_GPS HIL_STATE HIL_STATE_QUATERNION HIL_RC_INPUTS_RAW HIL_OPTICAL_FLOW
    OPEN_DRONE_ID_BASIC_ID OPEN_DRONE_ID_SYSTEM OPEN_DRONE_ID_SYSTEM_UPDATE OPEN_DRONE_ID_OPERATOR_ID
    OPEN_DRONE_ID_SELF_ID OPEN_DRONE_ID_LOCATION OPEN_DRONE_ID_AUTHENTICATION OPEN_DRONE_ID_MESSAGE_PACK)

  # Commands that only ask; the messages that carry commands, and the offset of the command in their payload.
  @questions Enum.map(
               ~w(GET_HOME_POSITION GET_MESSAGE_INTERVAL REQUEST_MESSAGE REQUEST_PROTOCOL_VERSION
               REQUEST_AUTOPILOT_CAPABILITIES REQUEST_CAMERA_INFORMATION REQUEST_CAMERA_SETTINGS
               REQUEST_STORAGE_INFORMATION REQUEST_CAMERA_CAPTURE_STATUS REQUEST_FLIGHT_INFORMATION)a,
               &(MavCmd.value(:"MAV_CMD_#{&1}") || raise("no command #{&1}"))
             )
  @carriers Enum.map(~w(COMMAND_INT COMMAND_LONG), &Message.id!/1)
  @command_at 28

  @heartbeat Message.id!("HEARTBEAT")
  @gcs MavType.value(:MAV_TYPE_GCS)

  @type kind :: :command | :input | :presence

  @doc "Whether a system id is a ground station's by convention. ArduPilot takes any heartbeat from its SYSID_MYGCS for its operator's."
  defguard is_station(system) when system >= 240

  @doc "What a frame does to a vehicle that gets it."
  @spec kind(Frame.t()) :: kind | nil
  def kind(%Frame{id: @heartbeat} = frame), do: presence(frame)

  def kind(%Frame{id: id} = frame) when id in @carriers,
    do: if(command(frame) not in @questions, do: :command)

  def kind(%Frame{id: id}), do: of(id)

  @doc "The command of a COMMAND_LONG or COMMAND_INT, nil of any other frame."
  @spec command(Frame.t()) :: 0..65_535 | nil
  def command(%Frame{id: id, payload: payload}) when id in @carriers do
    # Zeros at the end were cut off (F7).
    <<_parameters::binary-size(@command_at), command::16-little, _::binary>> = <<payload::binary, 0::240>>
    command
  end

  def command(%Frame{}), do: nil

  defp presence(%{system: system} = frame) do
    if is_station(system) or Heartbeat.read(frame).type == @gcs, do: :presence
  end

  for {kind, names} <- [command: @commands, input: @inputs], name <- names do
    defp of(unquote(Message.id!(name))), do: unquote(kind)
  end

  defp of(_other), do: nil
end
