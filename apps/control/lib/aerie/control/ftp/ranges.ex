defmodule Aerie.Control.Ftp.Ranges do
  @moduledoc "Which bytes of a file were received, as ranges `{from, to}` without `to`. The last one is the first in the list."

  @type t :: [{non_neg_integer(), pos_integer()}]

  @doc "Ranges of a file that is complete before `start`."
  @spec new(start :: non_neg_integer()) :: t()
  def new(0), do: []
  def new(start), do: [{0, start}]

  @doc "Adds received bytes."
  @spec add(t(), non_neg_integer(), non_neg_integer()) :: t()
  def add(ranges, from, to) when to <= from, do: ranges
  def add([{start, stop} | rest], from, to) when from >= start and to <= stop, do: [{start, stop} | rest]
  def add([{_start, stop} | _rest] = ranges, from, to) when from > stop, do: [{from, to} | ranges]
  def add([{start, _stop} = range | rest], from, to) when to < start, do: [range | add(rest, from, to)]
  def add([{start, stop} | rest], from, to), do: add(rest, min(start, from), max(stop, to))
  def add([], from, to), do: [{from, to}]

  @doc "The end of the last range."
  @spec top(t()) :: non_neg_integer()
  def top([]), do: 0
  def top([{_from, to} | _rest]), do: to

  @doc "The number of bytes received."
  @spec size(t()) :: non_neg_integer()
  def size(ranges),
    do: Enum.reduce(ranges, 0, fn {from, to}, size when is_integer(to) -> size + to - from end)

  @doc "The end of the first range, where the first gap begins."
  @spec contiguous(t()) :: non_neg_integer()
  def contiguous(ranges), do: with({0, to} <- List.last(ranges, nil) || {1, 0}, do: to, else: (_gap -> 0))

  @doc "The gaps below `top`, in order."
  @spec gaps(t(), top :: non_neg_integer()) :: [{non_neg_integer(), pos_integer()}]
  def gaps(ranges, top) do
    {gaps, at} =
      ranges
      |> Enum.reverse()
      |> Enum.reduce({[], 0}, fn {from, to}, {gaps, at} ->
        {if(from > at and at < top, do: [{at, min(from, top)} | gaps], else: gaps), to}
      end)

    Enum.reverse(if at < top, do: [{at, top} | gaps], else: gaps)
  end
end
