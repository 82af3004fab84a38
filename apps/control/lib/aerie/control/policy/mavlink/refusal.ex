defmodule Aerie.Control.Policy.Mavlink.Refusal do
  @moduledoc """
  What a refused message is answered with, in the vehicle's name: the refusal of its own protocol where it has one, and always
  a STATUSTEXT with the reason, because few ground stations show more than "denied".

  | message | answer |
  |---|---|
  | COMMAND_LONG, COMMAND_INT, SET_MODE | COMMAND_ACK, MAV_RESULT_DENIED |
  | MISSION_COUNT, MISSION_ITEM(_INT), MISSION_WRITE_PARTIAL_LIST, MISSION_CLEAR_ALL | MISSION_ACK, MAV_MISSION_DENIED |
  | MISSION_SET_CURRENT | MISSION_CURRENT with the item that is the current one |
  | PARAM_SET | the vehicle is asked for the value that it has, and its PARAM_VALUE is the answer (P3) |
  | PARAM_EXT_SET | PARAM_EXT_ACK, PARAM_ACK_FAILED, without a value; the component is asked for the one that it has (PARAM_EXT_VALUE) |
  | FILE_TRANSFER_PROTOCOL | NAK, FileProtected; for one without a definition UnknownCommand, as firmwares say |
  """

  alias MavCodec.Enums.{MavFtpErr, MavFtpOpcode, MavMissionResult, MavResult, MavSeverity, ParamAck}
  alias MavCodec.{Frame, Message}
  alias MavCodec.Messages, as: M

  @denied MavResult.value(:MAV_RESULT_DENIED)
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @mission_denied MavMissionResult.value(:MAV_MISSION_DENIED)
  @failed ParamAck.value(:PARAM_ACK_FAILED)
  @nak MavFtpOpcode.value(:MAV_FTP_OPCODE_NAK)
  @protected MavFtpErr.value(:MAV_FTP_ERR_FILEPROTECTED)
  @unknown_command MavFtpErr.value(:MAV_FTP_ERR_UNKNOWNCOMMAND)
  @warning MavSeverity.value(:MAV_SEVERITY_WARNING)
  # ArduPilot acknowledges SET_MODE by the number of the message.
  @set_mode MavCodec.Dialects.All.message_id("SET_MODE")
  @text_bytes 50
  @chunks 4

  @doc "The messages that answer it; `current` is the mission's current item, nil if that is not known."
  @spec messages(struct(), Frame.t(), current :: non_neg_integer() | nil) :: [struct()]
  def messages(%M.SetMode{}, frame, _current), do: [ack(@set_mode, frame)]

  def messages(%module{command: command}, frame, _current) when module in [M.CommandLong, M.CommandInt],
    do: [ack(command, frame)]

  def messages(%module{mission_type: type}, frame, _current)
      when module in [
             M.MissionCount,
             M.MissionItem,
             M.MissionItemInt,
             M.MissionWritePartialList,
             M.MissionClearAll
           ] do
    [
      %M.MissionAck{
        target_system: frame.system,
        target_component: frame.component,
        type: @mission_denied,
        mission_type: type
      }
    ]
  end

  def messages(%M.MissionSetCurrent{}, _frame, current) when is_integer(current),
    do: [%M.MissionCurrent{seq: current}]

  # The value of a failure is the one that stands (P8). It is not known here, and the refused one would be a lie.
  def messages(%M.ParamExtSet{} = m, _frame, _current),
    do: [%M.ParamExtAck{param_id: m.param_id, param_type: m.param_type, param_result: @failed}]

  def messages(%M.FileTransferProtocol{payload: payload}, frame, _current) do
    <<sequence::16-little, session, operation, _::binary>> = payload

    # A client then falls back to an operation that everybody knows.
    error = if MavFtpOpcode.name(operation), do: @protected, else: @unknown_command
    nak = <<Bitwise.band(sequence + 1, 0xFFFF)::16-little, session, @nak, 1, operation, 0, 0, 0::32, error>>

    [
      %M.FileTransferProtocol{
        target_system: frame.system,
        target_component: frame.component,
        payload: nak <> :binary.copy(<<0>>, 251 - byte_size(nak))
      }
    ]
  end

  def messages(_other, _frame, _current), do: []

  @doc "The answer to a command that the gateway itself carried out."
  @spec accepted(struct(), Frame.t()) :: struct()
  def accepted(%{command: command}, frame), do: %{ack(command, frame) | result: @accepted}

  @doc "The message to the vehicle in place of a refused one: a request whose answer shows the sender the present value."
  @spec instead(struct()) :: Message.t() | nil
  def instead(%M.ParamSet{} = m),
    do: %M.ParamRequestRead{
      target_system: m.target_system,
      target_component: m.target_component,
      param_id: m.param_id,
      param_index: -1
    }

  def instead(%M.ParamExtSet{} = m),
    do: %M.ParamExtRequestRead{
      target_system: m.target_system,
      target_component: m.target_component,
      param_id: m.param_id,
      param_index: -1
    }

  def instead(_other), do: nil

  @doc "The reason as STATUSTEXT, in chunks with this id where it is long (X2); none for nil."
  @spec texts(String.t() | nil, 1..0xFFFF) :: [struct()]
  def texts(nil, _id), do: []

  def texts(reason, id) do
    case chunks("refused: " <> reason) do
      [text] ->
        [%M.Statustext{severity: @warning, text: text}]

      texts ->
        for {text, n} <- Enum.with_index(texts),
            do: %M.Statustext{severity: @warning, text: text, id: id, chunk_seq: n}
    end
  end

  # A chunk that is full is followed by another one, so the last must not be.
  defp chunks(text) do
    bytes = text |> to_ascii() |> binary_part_up_to(@chunks * @text_bytes - 1)

    for start <- 0..(byte_size(bytes) - 1)//@text_bytes,
        do: binary_part(bytes, start, min(@text_bytes, byte_size(bytes) - start))
  end

  defp to_ascii(text), do: for(<<char::utf8 <- text>>, into: "", do: if(char < 128, do: <<char>>, else: "?"))
  defp binary_part_up_to(text, most), do: binary_part(text, 0, min(byte_size(text), most))

  defp ack(command, frame),
    do: %M.CommandAck{
      command: command,
      result: @denied,
      target_system: frame.system,
      target_component: frame.component
    }
end
