defmodule Aerie.Router.Orders do
  @moduledoc """
  Which messages change a vehicle, in one table: everything that a vehicle obeys, stores or believes. What only asks, or
  tells of the sender itself (ADSB_VEHICLE, FOLLOW_TARGET, COLLISION, GLOBAL_POSITION_INT), is none of it.

  | kind | |
  |---|---|
  | `:order` | commands, modes, set-points and sticks, writes of parameters, missions, fences and files, keys, consoles, rates |
  | `:input` | what estimators, clocks, flow control and safety functions take for true, whoever says it: external positions, corrections of GPS, ranges, simulated sensors, RADIO_STATUS |
  | `:presence` | a heartbeat that a vehicle may take for that of its ground station |
  | nil | the rest |

  MISSION_COUNT, MISSION_ITEM and FILE_TRANSFER_PROTOCOL go both ways: to a vehicle they write, from a vehicle they answer. So
  it depends on the addressee what an order is, which is for who uses this table (`Aerie.Router.Gate`).
  """

  alias Aerie.Mavlink.Heartbeat
  alias MavCodec.Dialects.All
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Frame

  @orders ~w(COMMAND_LONG COMMAND_INT COMMAND_CANCEL COMMAND_LONG_STAMPED COMMAND_INT_STAMPED SET_MODE
    CHANGE_OPERATOR_CONTROL AUTH_KEY SETUP_SIGNING
    MANUAL_CONTROL MANUAL_SETPOINT RC_CHANNELS_OVERRIDE RC_CHANNELS_OVERRIDE_V2 SET_ATTITUDE_TARGET
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
    GOPRO_SET_REQUEST LED_CONTROL PLAY_TUNE PLAY_TUNE_V2 OSD_PARAM_CONFIG REQUEST_DATA_STREAM)

  @inputs ~w(GPS_INPUT GPS_INJECT_DATA GPS_RTCM_DATA VISION_POSITION_ESTIMATE VISION_SPEED_ESTIMATE
    GLOBAL_VISION_POSITION_ESTIMATE VICON_POSITION_ESTIMATE ATT_POS_MOCAP ODOMETRY OPTICAL_FLOW OPTICAL_FLOW_RAD
    DISTANCE_SENSOR OBSTACLE_DISTANCE OBSTACLE_DISTANCE_3D LANDING_TARGET TERRAIN_DATA SYSTEM_TIME RADIO_STATUS RADIO
    HIL_SENSOR HIL_GPS HIL_STATE HIL_STATE_QUATERNION HIL_RC_INPUTS_RAW HIL_OPTICAL_FLOW
    OPEN_DRONE_ID_BASIC_ID OPEN_DRONE_ID_SYSTEM OPEN_DRONE_ID_SYSTEM_UPDATE OPEN_DRONE_ID_OPERATOR_ID
    OPEN_DRONE_ID_SELF_ID)

  # Commands that ask and change nothing, the ids of both messages that carry them, and where in the payload they stand.
  @questions Enum.map(
               ~w(GET_HOME_POSITION GET_MESSAGE_INTERVAL REQUEST_MESSAGE REQUEST_PROTOCOL_VERSION
               REQUEST_AUTOPILOT_CAPABILITIES REQUEST_CAMERA_INFORMATION REQUEST_CAMERA_SETTINGS
               REQUEST_STORAGE_INFORMATION REQUEST_CAMERA_CAPTURE_STATUS REQUEST_FLIGHT_INFORMATION)a,
               &(MavCmd.value(:"MAV_CMD_#{&1}") || raise("no command #{&1}"))
             )
  @commands [All.message_id("COMMAND_INT"), All.message_id("COMMAND_LONG")]
  @command_at 28

  @gcs 6
  # Ids from here on are ground stations' by convention; ArduPilot takes any heartbeat of its SYSID_MYGCS for the operator's.
  @ground_stations 240

  @type kind :: :order | :input | :presence

  @doc "What kind of message a frame is for a vehicle that gets it."
  @spec kind(Frame.t()) :: kind | nil
  def kind(%Frame{id: 0} = frame), do: presence(frame)
  def kind(%Frame{id: id} = frame) when id in @commands, do: if(command(frame) not in @questions, do: :order)
  def kind(%Frame{id: id}), do: of(id)

  @doc "The command of a COMMAND_LONG or COMMAND_INT, nil of any other frame."
  @spec command(Frame.t()) :: 0..65_535 | nil
  def command(%Frame{id: id, payload: payload}) when id in @commands do
    # Zeros at the end were cut off (F7).
    <<_parameters::binary-size(@command_at), command::16-little, _::binary>> = <<payload::binary, 0::240>>
    command
  end

  def command(%Frame{}), do: nil

  defp presence(%{system: system} = frame) do
    if system >= @ground_stations or Heartbeat.read(frame).type == @gcs, do: :presence
  end

  for {kind, names} <- [order: @orders, input: @inputs], name <- names do
    defp of(unquote(All.message_id(name) || raise("no message #{name}"))), do: unquote(kind)
  end

  defp of(_other), do: nil
end
