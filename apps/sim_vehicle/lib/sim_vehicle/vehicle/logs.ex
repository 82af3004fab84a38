defmodule SimVehicle.Vehicle.Logs do
  @moduledoc """
  The logs on board: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END. Data is sent at a steady rate until the request is served,
  replaced or ended; a packet of fewer than 90 bytes is the end of the log. Ids begin at 1 (ArduPilot) or 0 (PX4).
  """

  alias MavCodec.Messages, as: M

  @piece 90
  # In a step, which is 5 to 40 ms.
  @pieces 10

  defstruct first: 1, logs: [], sending: nil

  @type t :: %__MODULE__{}

  @doc "Logs as binaries."
  @spec new(:ardupilot | :px4, [binary]) :: t
  def new(style, logs), do: %__MODULE__{first: if(style == :px4, do: 0, else: 1), logs: logs}

  @doc "Nothing is being sent."
  @spec reboot(t) :: t
  def reboot(logs), do: %{logs | sending: nil}

  @doc "A request; nil for another message."
  @spec handle(t, struct) :: {t, [struct]} | nil
  def handle(%{logs: []} = logs, %M.LogRequestList{}), do: {logs, [%M.LogEntry{}]}

  def handle(logs, %M.LogRequestList{start: first, end: last}) do
    count = length(logs.logs)

    entries =
      for {log, n} <- Enum.with_index(logs.logs, logs.first), n >= first, n <= last do
        %M.LogEntry{
          id: n,
          num_logs: count,
          last_log_num: logs.first + count - 1,
          size: byte_size(log),
          time_utc: 1_795_000_000 + n
        }
      end

    {logs, entries}
  end

  def handle(logs, %M.LogRequestData{id: id, ofs: offset, count: count}) do
    if id >= logs.first and id < logs.first + length(logs.logs),
      do: {%{logs | sending: {id, offset, count}}, []},
      else: {logs, []}
  end

  def handle(logs, %M.LogRequestEnd{}), do: {%{logs | sending: nil}, []}
  def handle(_logs, _message), do: nil

  @doc "What is sent in a step."
  @spec tick(t) :: {t, [struct]}
  def tick(%{sending: nil} = logs), do: {logs, []}
  def tick(logs), do: pieces(logs, @pieces, [])

  defp pieces(%{sending: nil} = logs, _left, sent), do: {logs, Enum.reverse(sent)}
  defp pieces(logs, 0, sent), do: {logs, Enum.reverse(sent)}

  defp pieces(%{sending: {id, offset, count}} = logs, left, sent) do
    log = Enum.at(logs.logs, id - logs.first)
    size = Enum.min([@piece, count, max(byte_size(log) - offset, 0)])
    data = if size > 0, do: binary_part(log, offset, size), else: ""
    piece = %M.LogData{id: id, ofs: offset, count: size, data: data <> <<0::size((@piece - size) * 8)>>}
    sending = if size == @piece and count > size, do: {id, offset + size, count - size}
    pieces(%{logs | sending: sending}, left - 1, [piece | sent])
  end
end
