defmodule MavRouter.Sharing.TransferLock.Transfer do
  @moduledoc """
  Which step of a transfer a frame is. A vehicle has one partner at a time for missions, fences and rally points (one transfer,
  whatever their `mission_type`, as in PX4), one for sessions of files, and one for logs: a vehicle sends one log, to everybody, and a
  request for another one ends it.

  | | | `:begin` | `:more` | `:end` |
  |---|---|---|---|---|
  | mission | asks | MISSION_COUNT, MISSION_WRITE_PARTIAL_LIST, MISSION_REQUEST_LIST, MISSION_REQUEST_PARTIAL_LIST, MISSION_CLEAR_ALL | MISSION_REQUEST, MISSION_REQUEST_INT, MISSION_ITEM, MISSION_ITEM_INT | MISSION_ACK |
  | | vehicle | | the same and MISSION_COUNT | MISSION_ACK, MISSION_COUNT of 0 |
  | file | asks | opens, creates, ResetSessions | reads, writes, bursts | TerminateSession |
  | | vehicle | | answers | answer to TerminateSession and ResetSessions, refusal of an open |
  | log | asks | LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_ERASE | | LOG_REQUEST_END |
  | | vehicle | | LOG_DATA, LOG_ENTRY | LOG_ENTRY of the last log |
  """

  alias MavCodec.MessageId
  alias MavCodec.Enums.MavFtpOpcode
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @kinds [:mission, :file, :log]
  # Parts of a log transfer that end by themselves.
  @list 0
  @data 1
  @erase 2

  @type kind :: :mission | :file | :log

  @typedoc "`part`: what ends by itself within a transfer, such as each mission type"
  @type t :: {kind(), :begin | :more | :end, part :: 0..255}

  @ids Enum.map(
         ~w(MISSION_REQUEST_PARTIAL_LIST MISSION_WRITE_PARTIAL_LIST MISSION_ITEM MISSION_REQUEST MISSION_REQUEST_LIST
         MISSION_COUNT MISSION_CLEAR_ALL MISSION_ACK MISSION_REQUEST_INT MISSION_ITEM_INT FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_ENTRY
         LOG_REQUEST_DATA LOG_DATA LOG_ERASE LOG_REQUEST_END),
         &MessageId.of!/1
       )

  opcode = &(MavFtpOpcode.value(:"MAV_FTP_OPCODE_#{&1}") || raise("no opcode #{&1}"))
  @terminate opcode.("TERMINATESESSION")
  @reset opcode.("RESETSESSION")
  @opens Enum.map(~w(OPENFILERO CREATEFILE OPENFILEWO), opcode)
  @transfers Enum.map(~w(READFILE WRITEFILE BURSTREADFILE), opcode)
  @nak opcode.("NAK")
  @answers [opcode.("ACK"), @nak]

  @doc "The kinds of transfers, each of which has turns of its own."
  @spec kinds() :: [kind()]
  def kinds, do: @kinds

  @doc "Whether a message may be a step of a transfer. Cheap, because it is asked of every frame."
  defguard is_part(id) when id in @ids

  @doc "The step of a frame to a vehicle; nil for what is not part of a transfer."
  @spec asked(Frame.t()) :: t | nil
  def asked(frame) do
    case decoded(frame) do
      %M.FileTransferProtocol{payload: payload} ->
        file(payload)

      %M.LogRequestList{} ->
        {:log, :begin, @list}

      %M.LogRequestData{} ->
        {:log, :begin, @data}

      %M.LogErase{} ->
        {:log, :begin, @erase}

      %M.LogRequestEnd{} ->
        {:log, :end, @data}

      %M.MissionAck{mission_type: type} ->
        {:mission, :end, type}

      %kind{mission_type: type} when kind in [M.MissionItem, M.MissionItemInt] ->
        {:mission, :more, type}

      %kind{mission_type: type} when kind in [M.MissionRequest, M.MissionRequestInt] ->
        {:mission, :more, type}

      %{mission_type: type} ->
        {:mission, :begin, type}

      _none ->
        nil
    end
  end

  @doc "The step of a frame from a vehicle to its partner; nil for what is not part of a transfer."
  @spec answered(Frame.t()) :: t | nil
  def answered(frame) do
    case decoded(frame) do
      %M.FileTransferProtocol{payload: payload} -> answer(payload)
      %M.MissionAck{mission_type: type} -> {:mission, :end, type}
      %M.MissionCount{count: 0, mission_type: type} -> {:mission, :end, type}
      %{mission_type: type} -> {:mission, :more, type}
      %M.LogEntry{id: last, last_log_num: last} -> {:log, :end, @list}
      %M.LogEntry{num_logs: 0} -> {:log, :end, @list}
      %kind{} when kind in [M.LogEntry, M.LogData] -> {:log, :more, @data}
      _none -> nil
    end
  end

  defp decoded(%Frame{crc_extra: nil}), do: nil

  defp decoded(frame) do
    case MavCodec.decode(frame) do
      {:ok, %{} = message} -> message
      _unreadable -> nil
    end
  end

  # Sequence number, session, opcode, size, in answers the opcode that is answered.
  defp file(payload) do
    case :erlang.iolist_to_binary(payload) do
      <<_seq::16, _session, opcode, _::binary>> when opcode in @opens or opcode == @reset ->
        {:file, :begin, 0}

      <<_seq::16, _session, opcode, _::binary>> when opcode in @transfers ->
        {:file, :more, 0}

      <<_seq::16, _session, @terminate, _::binary>> ->
        {:file, :end, 0}

      _other ->
        nil
    end
  end

  defp answer(payload) do
    case :erlang.iolist_to_binary(payload) do
      <<_seq::16, _session, opcode, _size, request, _::binary>>
      when opcode in @answers and request in [@terminate, @reset] ->
        {:file, :end, 0}

      <<_seq::16, _session, @nak, _size, request, _::binary>> when request in @opens ->
        {:file, :end, 0}

      <<_seq::16, _session, opcode, _::binary>> when opcode in @answers ->
        {:file, :more, 0}

      _other ->
        nil
    end
  end
end
