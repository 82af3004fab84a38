defmodule Aerie.Incident.Series do
  @moduledoc """
  A value over time for a plot: however many points come, at most four of each interval are kept, its first, its last, its least and its
  greatest, so that no peak is lost. Pure.
  """

  @intervals 600

  @enforce_keys [:from, :width]
  defstruct [:from, :width, kept: %{}]

  @typedoc "`width`: microseconds of an interval."
  @type t :: %__MODULE__{from: integer(), width: pos_integer(), kept: %{non_neg_integer() => tuple()}}
  @type point :: {at :: integer(), value :: number()}

  @doc "An empty one for a span."
  @spec new(Aerie.Incident.Span.t()) :: t()
  def new(%{from: from, to: to}), do: %__MODULE__{from: from, width: max(div(to - from, @intervals), 1)}

  @doc "Adds a point. Points come in the order of their times; what is not a number is left out."
  @spec push(t(), integer(), term()) :: t()
  def push(%__MODULE__{} = series, at, value) when is_number(value) and at >= series.from do
    point = {at, value}

    kept =
      Map.update(series.kept, div(at - series.from, series.width), {point, point, point, point}, fn
        {first, least, greatest, _last} -> {first, less(point, least), more(point, greatest), point}
      end)

    %{series | kept: kept}
  end

  def push(series, _at, _value), do: series

  @doc "The points, in order."
  @spec points(t()) :: [point()]
  def points(%__MODULE__{kept: kept}) do
    kept
    |> Enum.sort()
    |> Enum.flat_map(fn {_interval, four} -> four |> Tuple.to_list() |> Enum.uniq() |> Enum.sort() end)
  end

  defp less({_, a} = point, {_, b}) when a < b, do: point
  defp less(_point, least), do: least
  defp more({_, a} = point, {_, b}) when a > b, do: point
  defp more(_point, greatest), do: greatest
end
