defmodule MavRouter.Recorder.Tap do
  @moduledoc """
  From the processes that have frames to those that write them, without ever waiting.

  Each recording has a queue of its own, counted in bytes: those sent to it and not on the disk yet. When it is full (the disk is slow,
  or hangs), further frames are dropped here, and counted. So a bad disk costs records, never frames, and a bounded amount of memory.
  """

  alias MavRouter.Recorder.Tables
  alias MavCodec.Frame
  alias MavCodec.Signing.Redact

  @waiting 1
  @dropped 2
  # A frame's part of the message that carries it, and of the list that it is in.
  @overhead 200

  @type counters :: :counters.counters_ref()

  @doc """
  The calling process gets the frames of a target from now on, as messages `{:record, target, bytes, frames, n}`, and calls `done/2` for
  each. `n` is the number of the ring's entry with these frames, `:sent` for those that a link sent, or nil.
  """
  @spec open(Tables.t(), Tables.target(), pos_integer) :: counters
  def open(tables, target, limit) do
    counters = :counters.new(2, [:write_concurrency])
    true = :ets.insert(tables.taps, {target, self(), counters, limit})
    counters
  end

  @doc "Ends `open/3`, for the calling process or one that is gone."
  @spec close(Tables.t(), Tables.target(), pid) :: :ok
  def close(tables, target, pid \\ self()) do
    true = :ets.match_delete(tables.taps, {target, pid, :_, :_})
    :ok
  end

  @doc "The frames of a message, of so many bytes, are written or dropped."
  @spec done(counters, non_neg_integer) :: :ok
  def done(counters, bytes), do: :counters.sub(counters, @waiting, bytes)

  @doc "Frames dropped because the queue was full."
  @spec dropped(counters) :: non_neg_integer
  def dropped(counters), do: :counters.get(counters, @dropped)

  @doc "Bytes that wait in the queue."
  @spec waiting(counters) :: non_neg_integer
  def waiting(counters), do: :counters.get(counters, @waiting)

  @doc "Hands frames to all that record the target."
  @spec offer(Tables.t(), Tables.target(), [Frame.t()], pos_integer | :sent | nil) :: :ok
  def offer(tables, target, frames, n \\ nil) do
    case :ets.lookup(tables.taps, target) do
      [] -> :ok
      taps -> offer_to(taps, without_keys(frames), bytes(frames), n)
    end
  end

  # The writer removes secrets as well, but a process that crashes shows its last message (S9).
  defp without_keys(frames) do
    if Enum.any?(frames, &Redact.secret?/1), do: Enum.map(frames, &Redact.frame/1), else: frames
  end

  @doc "Ends the taps of processes that died."
  @spec sweep(Tables.t()) :: :ok
  def sweep(tables) do
    for {target, pid, _counters, _limit} <- :ets.tab2list(tables.taps),
        not Process.alive?(pid),
        do: close(tables, target, pid)

    :ok
  end

  @doc "Whether anyone records the target."
  @spec open?(Tables.t(), Tables.target()) :: boolean
  def open?(tables, target), do: :ets.member(tables.taps, target)

  @doc "Whether a process has a tap on the target."
  @spec tapped?(Tables.t(), Tables.target(), pid) :: boolean
  def tapped?(tables, target, pid),
    do:
      Enum.any?(:ets.lookup(tables.taps, target), fn {_target, owner, _counters, _limit} -> owner == pid end)

  defp offer_to(taps, frames, bytes, n) do
    Enum.each(taps, fn {target, pid, counters, limit} ->
      if :counters.get(counters, @waiting) + bytes <= limit do
        :counters.add(counters, @waiting, bytes)
        send(pid, {:record, target, bytes, frames, n})
      else
        :counters.add(counters, @dropped, length(frames))
      end
    end)
  end

  defp bytes(frames), do: Enum.reduce(frames, 0, &(byte_size(&1.bytes) + @overhead + &2))
end
