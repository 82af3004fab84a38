defmodule SimVehicle.Services.Streams do
  @moduledoc """
  The intervals of streamed messages, in microseconds of vehicle time, by message id.

  As in real firmware, the rates belong to the channel, not to the requester: the last request wins (rule M2).
  """

  defstruct intervals: %{}, defaults: %{}, due: %{}

  @type t :: %__MODULE__{}

  @doc "Streams at `rates`, a map of message id to messages per second."
  @spec new(%{non_neg_integer => number}) :: t
  def new(rates) do
    intervals = for {id, hz} <- rates, hz > 0, into: %{}, do: {id, interval(hz)}
    %__MODULE__{intervals: intervals, defaults: intervals}
  end

  @doc "Sets the interval as SET_MESSAGE_INTERVAL does: -1 stops, 0 returns to the default, else microseconds."
  @spec set(t, non_neg_integer, integer) :: t
  def set(streams, id, -1), do: stop(streams, id)

  def set(streams, id, 0) do
    case streams.defaults do
      %{^id => interval} -> put(streams, id, interval)
      _none -> stop(streams, id)
    end
  end

  def set(streams, id, interval) when interval > 0, do: put(streams, id, interval)

  @doc "Sets several messages to `hz` per second, as REQUEST_DATA_STREAM does; 0 stops them."
  @spec set_rate([non_neg_integer], t, number) :: t
  def set_rate(ids, streams, hz) do
    interval = if hz > 0, do: interval(hz), else: -1
    Enum.reduce(ids, streams, &set(&2, &1, interval))
  end

  @doc "Interval in microseconds, -1 when the message is not streamed (the coding of MESSAGE_INTERVAL)."
  @spec interval_us(t, non_neg_integer) :: integer
  def interval_us(streams, id), do: Map.get(streams.intervals, id, -1)

  @doc "The ids to send at vehicle time `now` (microseconds), and the streams after that."
  @spec due(t, integer) :: {[non_neg_integer], t}
  def due(streams, now) do
    Enum.reduce(streams.intervals, {[], streams}, fn {id, interval}, {ids, streams} ->
      # The first message comes one interval after the request, staggered so that streams do not coincide.
      at = Map.get_lazy(streams.due, id, fn -> now + rem(id * 7_919, max(interval, 1)) end)

      cond do
        now < at and is_map_key(streams.due, id) -> {ids, streams}
        now < at -> {ids, %{streams | due: Map.put(streams.due, id, at)}}
        true -> {[id | ids], %{streams | due: Map.put(streams.due, id, next(at, interval, now))}}
      end
    end)
  end

  # After a pause (a frozen vehicle) missed messages are skipped.
  defp next(at, interval, now) when now - at > interval, do: now + interval
  defp next(at, interval, _now), do: at + interval

  defp put(streams, id, interval) do
    %{streams | intervals: Map.put(streams.intervals, id, interval), due: Map.delete(streams.due, id)}
  end

  defp stop(streams, id) do
    %{streams | intervals: Map.delete(streams.intervals, id), due: Map.delete(streams.due, id)}
  end

  defp interval(hz), do: max(round(1_000_000 / hz), 1)
end
