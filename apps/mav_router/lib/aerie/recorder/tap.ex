defmodule Aerie.Recorder.Tap do
  @moduledoc """
  From those who have frames to those who write them, without ever waiting.

  Each recording has a queue of its own, counted in bytes: what has been sent to it and is not on the disk yet. When it is
  full (the disk is slow, or hangs), further frames are dropped, here and now, and counted. So a disk costs records, never
  frames, and never more memory than that.
  """

  alias Aerie.Recorder.Tables
  alias MavCodec.{Frame, Redact}

  @waiting 1
  @dropped 2
  @setup_signing 256
  # A frame's part of the message that carries it, and of the list that it is in.
  @overhead 200

  @type counters :: :counters.counters_ref()

  @doc "Begins to get the frames of a target: messages `{:record, bytes, frames, n}`, each to be answered by `done/2`; `n` is
  the number of the ring's entry with those frames, or nil."
  @spec open(Tables.t(), Tables.target(), pos_integer) :: counters
  def open(tables, target, limit) do
    counters = :counters.new(2, [:write_concurrency])
    true = :ets.insert(tables.taps, {target, self(), counters, limit})
    counters
  end

  @doc "Ends it, for the calling process or one that is gone."
  @spec close(Tables.t(), Tables.target(), pid) :: :ok
  def close(tables, target, pid \\ self()) do
    true = :ets.match_delete(tables.taps, {target, pid, :_, :_})
    :ok
  end

  @doc "What came by a message is dealt with."
  @spec done(counters, non_neg_integer) :: :ok
  def done(counters, bytes), do: :counters.sub(counters, @waiting, bytes)

  @doc "Frames dropped because the queue was full."
  @spec dropped(counters) :: non_neg_integer
  def dropped(counters), do: :counters.get(counters, @dropped)

  @doc "Bytes that wait."
  @spec waiting(counters) :: non_neg_integer
  def waiting(counters), do: :counters.get(counters, @waiting)

  @doc "Hands frames to everyone who records the target."
  @spec offer(Tables.t(), Tables.target(), [Frame.t()], pos_integer | nil) :: :ok
  def offer(tables, target, frames, n \\ nil) do
    case :ets.lookup(tables.taps, target) do
      [] -> :ok
      taps -> offer_to(taps, without_keys(frames), bytes(frames), n)
    end
  end

  # The writer takes them out too. But a process that crashes shows its last message, and there they must not be either (S9).
  defp without_keys(frames) do
    if Enum.any?(frames, &(&1.id == @setup_signing)), do: Enum.map(frames, &Redact.frame/1), else: frames
  end

  @doc "Ends the taps of processes that are gone without having said so."
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

  defp offer_to(taps, frames, bytes, n) do
    Enum.each(taps, fn {_target, pid, counters, limit} ->
      if :counters.get(counters, @waiting) + bytes <= limit do
        :counters.add(counters, @waiting, bytes)
        send(pid, {:record, bytes, frames, n})
      else
        :counters.add(counters, @dropped, length(frames))
      end
    end)
  end

  defp bytes(frames), do: Enum.reduce(frames, 0, &(byte_size(&1.bytes) + @overhead + &2))
end
