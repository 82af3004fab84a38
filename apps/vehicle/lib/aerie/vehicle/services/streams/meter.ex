defmodule Aerie.Vehicle.Services.Streams.Meter do
  @moduledoc """
  Measures how often messages come. A pure value.

  Messages are counted per link, and the highest count gives the rate: two redundant links that bring the same frames do not
  double it. Only watched messages are counted.
  """

  @links 8

  defstruct watched: %{}

  @typedoc "By message id: since when it is counted, how many came by which link, and when the last one came."
  @type t :: %__MODULE__{
          watched: %{
            non_neg_integer() => {since :: integer(), %{term() => pos_integer()}, last :: integer() | nil}
          }
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Begins to count a message from 0."
  @spec watch(t(), non_neg_integer(), integer()) :: t()
  def watch(meter, id, now) do
    last = with {_since, _counts, last} <- meter.watched[id], do: last
    %{meter | watched: Map.put(meter.watched, id, {now, %{}, last})}
  end

  @doc "Like `watch/3`, unless the message is counted already."
  @spec ensure(t(), non_neg_integer(), integer()) :: t()
  def ensure(%{watched: watched} = meter, id, _now) when is_map_key(watched, id), do: meter
  def ensure(meter, id, now), do: watch(meter, id, now)

  @doc "Stops counting a message."
  @spec ignore(t(), non_neg_integer()) :: t()
  def ignore(meter, id), do: %{meter | watched: Map.delete(meter.watched, id)}

  @doc "A message came by a link."
  @spec received(t(), term(), non_neg_integer(), integer()) :: t()
  def received(%{watched: watched} = meter, link, id, at) do
    case watched do
      %{^id => {since, counts, _last}} ->
        %{meter | watched: %{watched | id => {since, bump(counts, link), at}}}

      _unwatched ->
        meter
    end
  end

  defp bump(counts, link) do
    case counts do
      %{^link => n} -> %{counts | link => n + 1}
      _new when map_size(counts) < @links -> Map.put(counts, link, 1)
      _full -> counts
    end
  end

  @doc "Messages per second since counting began, once that is `long_enough` (us) ago; nil before."
  @spec rate(t(), non_neg_integer(), integer(), pos_integer()) :: float() | nil
  def rate(meter, id, now, long_enough) do
    case meter.watched do
      %{^id => {since, counts, _last}} when now - since >= long_enough ->
        (counts |> Map.values() |> Enum.max(fn -> 0 end)) * 1_000_000 / (now - since)

      _too_short ->
        nil
    end
  end

  @doc "When a watched message last came; nil for never."
  @spec last(t(), non_neg_integer()) :: integer() | nil
  def last(meter, id), do: with({_since, _counts, last} <- meter.watched[id], do: last)

  @doc "Counts everything from 0 again, as after a silence or a change of the clock."
  @spec restart(t(), integer()) :: t()
  def restart(meter, now) do
    %{meter | watched: Map.new(meter.watched, fn {id, {_, _, last}} -> {id, {now, %{}, last && now}} end)}
  end
end
