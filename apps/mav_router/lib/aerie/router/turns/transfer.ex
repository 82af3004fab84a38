defmodule Aerie.Router.Turns.Transfer do
  @moduledoc """
  What a frame says in a transfer that a vehicle has with one partner at a time: missions, fences and rally points (one
  transfer, whatever `mission_type`, as PX4 has it), and sessions of files.

  | | | `:begin` | `:more` | `:end` |
  |---|---|---|---|---|
  | mission | asks | MISSION_COUNT, MISSION_WRITE_PARTIAL_LIST, MISSION_REQUEST_LIST, MISSION_REQUEST_PARTIAL_LIST, MISSION_CLEAR_ALL | MISSION_REQUEST, MISSION_REQUEST_INT, MISSION_ITEM, MISSION_ITEM_INT | MISSION_ACK |
  | | vehicle | | the same and MISSION_COUNT | MISSION_ACK, MISSION_COUNT of 0 |
  | file | asks | opens, creates, ResetSessions | reads, writes, bursts | TerminateSession |
  | | vehicle | | answers | answer to TerminateSession and ResetSessions, refusal of an open |
  """

  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @typedoc "`part`: what ends by itself within a transfer: the mission type"
  @type t :: {kind :: :mission | :file, :begin | :more | :end, part :: 0..255}

  @ids [37, 38, 39, 40, 43, 44, 45, 47, 51, 73, 110]

  # Opcodes of files.
  @terminate 1
  @reset 2
  @opens [4, 6, 11]
  @going_on [5, 7, 15]
  @refused 129
  @answers [128, 129]

  @doc "Whether a message may be part of one. Cheap, for every frame."
  defguard is_part(id) when id in @ids

  @doc "What somebody who asks says to a vehicle; nil for what is no part of a transfer."
  @spec asked(Frame.t()) :: t | nil
  def asked(frame) do
    case decoded(frame) do
      %M.FileTransferProtocol{payload: payload} ->
        file(payload)

      %M.MissionAck{mission_type: type} ->
        {:mission, :end, type}

      %kind{mission_type: type} when kind in [M.MissionItem, M.MissionItemInt] ->
        {:mission, :more, type}

      %kind{mission_type: type} when kind in [M.MissionRequest, M.MissionRequestInt] ->
        {:mission, :more, type}

      %{mission_type: type} ->
        {:mission, :begin, type}

      nil ->
        nil
    end
  end

  @doc "What the vehicle says to who asked it."
  @spec answered(Frame.t()) :: t | nil
  def answered(frame) do
    case decoded(frame) do
      %M.FileTransferProtocol{payload: payload} -> answer(payload)
      %M.MissionAck{mission_type: type} -> {:mission, :end, type}
      %M.MissionCount{count: 0, mission_type: type} -> {:mission, :end, type}
      %{mission_type: type} -> {:mission, :more, type}
      nil -> nil
    end
  end

  defp decoded(%Frame{crc_extra: nil}), do: nil

  defp decoded(frame) do
    case MavCodec.decode(frame) do
      {:ok, %{} = message} -> message
      _unreadable -> nil
    end
  end

  # seq, session, opcode, size, the opcode that is answered.
  defp file(payload) do
    case :erlang.iolist_to_binary(payload) do
      <<_seq::16, _session, opcode, _::binary>> when opcode in @opens or opcode == @reset ->
        {:file, :begin, 0}

      <<_seq::16, _session, opcode, _::binary>> when opcode in @going_on ->
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

      <<_seq::16, _session, @refused, _size, request, _::binary>> when request in @opens ->
        {:file, :end, 0}

      <<_seq::16, _session, opcode, _::binary>> when opcode in @answers ->
        {:file, :more, 0}

      _other ->
        nil
    end
  end
end
