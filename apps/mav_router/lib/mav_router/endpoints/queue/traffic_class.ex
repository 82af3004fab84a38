defmodule MavRouter.Endpoints.Queue.TrafficClass do
  @moduledoc """
  The class of a message, which decides what goes first when there is not enough room:

  | class | | messages |
  |---|---|---|
  | `:control` | first | heartbeats, commands, modes, manual control and set-points |
  | `:ack` | | answers to those, texts, time and radio status |
  | `:state` | | telemetry, and every message that is in no other class, unknown ones included |
  | `:transfer` | | parameters, missions, fences, rally points |
  | `:bulk` | last | files, logs, tunnels, images, debug vectors |
  """

  alias MavCodec.MessageId

  @type class :: :control | :ack | :state | :transfer | :bulk

  @classes [:control, :ack, :state, :transfer, :bulk]

  @names %{
    control:
      ~w(HEARTBEAT SET_MODE COMMAND_LONG COMMAND_INT COMMAND_CANCEL COMMAND_LONG_STAMPED COMMAND_INT_STAMPED
      MANUAL_CONTROL RC_CHANNELS_OVERRIDE RC_CHANNELS_OVERRIDE_V2 SET_ATTITUDE_TARGET SET_POSITION_TARGET_LOCAL_NED
      SET_POSITION_TARGET_GLOBAL_INT SET_ACTUATOR_CONTROL_TARGET CHANGE_OPERATOR_CONTROL MANUAL_SETPOINT
      MISSION_SET_CURRENT GIMBAL_CONTROL GIMBAL_MANAGER_SET_ATTITUDE GIMBAL_MANAGER_SET_PITCHYAW
      GIMBAL_MANAGER_SET_MANUAL_CONTROL GIMBAL_DEVICE_SET_ATTITUDE MOUNT_CONTROL DIGICAM_CONTROL
      SET_VELOCITY_LIMITS COLLISION HIGH_LATENCY HIGH_LATENCY2),
    ack:
      ~w(COMMAND_ACK MISSION_ACK PARAM_EXT_ACK PARAM_ERROR CHANGE_OPERATOR_CONTROL_ACK CONTROL_STATUS STATUSTEXT
      EVENT CURRENT_EVENT_SEQUENCE RESPONSE_EVENT_ERROR REQUEST_EVENT PING TIMESYNC SYSTEM_TIME RADIO_STATUS RADIO
      MISSION_CURRENT MISSION_ITEM_REACHED AUTOPILOT_VERSION PROTOCOL_VERSION HOME_POSITION MESSAGE_INTERVAL
      REQUEST_DATA_STREAM),
    transfer:
      ~w(PARAM_REQUEST_READ PARAM_REQUEST_LIST PARAM_VALUE PARAM_SET PARAM_MAP_RC PARAM_EXT_REQUEST_READ
      PARAM_EXT_REQUEST_LIST PARAM_EXT_VALUE PARAM_EXT_SET PARAM_VALUE_ARRAY MISSION_REQUEST_PARTIAL_LIST
      MISSION_WRITE_PARTIAL_LIST MISSION_ITEM MISSION_REQUEST MISSION_REQUEST_LIST MISSION_COUNT MISSION_CLEAR_ALL
      MISSION_REQUEST_INT MISSION_CHECKSUM MISSION_ITEM_INT FENCE_POINT FENCE_FETCH_POINT RALLY_POINT
      RALLY_FETCH_POINT TERRAIN_REQUEST TERRAIN_DATA COMPONENT_INFORMATION COMPONENT_METADATA AVAILABLE_MODES),
    bulk:
      ~w(FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_ENTRY LOG_REQUEST_DATA LOG_DATA LOG_ERASE LOG_REQUEST_END
      LOGGING_DATA LOGGING_DATA_ACKED LOGGING_ACK REMOTE_LOG_DATA_BLOCK REMOTE_LOG_BLOCK_STATUS SERIAL_CONTROL
      DATA_TRANSMISSION_HANDSHAKE ENCAPSULATED_DATA TUNNEL V2_EXTENSION CAN_FRAME CANFD_FRAME DATA16 DATA32 DATA64
      DATA96 DEBUG DEBUG_VECT DEBUG_FLOAT_ARRAY NAMED_VALUE_FLOAT NAMED_VALUE_INT NAMED_VALUE_STRING MEMORY_VECT
      DEVICE_OP_READ DEVICE_OP_READ_REPLY DEVICE_OP_WRITE DEVICE_OP_WRITE_REPLY PID_TUNING RAW_IMU SCALED_IMU
      SCALED_IMU2 SCALED_IMU3 HIGHRES_IMU)
  }

  @doc "All classes, the most important first."
  @spec classes() :: [class]
  def classes, do: @classes

  @doc "The class of a message id."
  @spec of(non_neg_integer) :: class
  for {class, names} <- @names, name <- names do
    def of(unquote(MessageId.of!(name))), do: unquote(class)
  end

  def of(_other), do: :state

  @doc "The class of a name, nil for none."
  @spec parse(String.t()) :: class | nil
  for class <- @classes, do: def(parse(unquote(Atom.to_string(class))), do: unquote(class))
  def parse(_other), do: nil

  @doc "Runs of frames of one class, in order: their class, bytes and number."
  @spec runs([MavCodec.Frame.t()]) :: [{class, [binary], pos_integer}]
  def runs([frame | rest]), do: runs(rest, of(frame.id), [frame.bytes], 1)
  def runs([]), do: []

  defp runs([], class, bytes, n), do: [{class, Enum.reverse(bytes), n}]

  defp runs([frame | rest], class, bytes, n) do
    case of(frame.id) do
      ^class -> runs(rest, class, [frame.bytes | bytes], n + 1)
      other -> [{class, Enum.reverse(bytes), n} | runs(rest, other, [frame.bytes], 1)]
    end
  end
end
