defmodule Aerie.Console.Pages.Fleet.Sequence do
  @moduledoc """
  Which rows the table shows, and in which places. Pure.

  Rows under a hand keep their places: while the pointer is over the table, something in it has the focus, or a vehicle is selected. Vehicles
  that stop matching the filter stay then, and others that begin to match come last. Otherwise the table is sorted every five seconds, and at
  once when vehicles come or go. What somebody asks for, another filter or order, is done at once in any case (`sort/3`).
  """

  @again_ms 5_000

  defstruct ids: [], at: nil, differs: false

  @typedoc "`:at` - when it was sorted, in ms; `:differs` - whether sorting would move something"
  @type t :: %__MODULE__{ids: [String.t()], at: integer() | nil, differs: boolean()}

  @doc "Sorted now, whatever is held: `sorted` are the ids that match, in order."
  @spec sort(t(), sorted :: [String.t()], now_ms :: integer()) :: t()
  def sort(_sequence, sorted, now), do: %__MODULE__{ids: sorted, at: now}

  @doc "After the vehicles have changed: `all` are their ids. `held?`: whether the rows keep their places."
  @spec follow(t(), sorted :: [String.t()], all :: [String.t()], held? :: boolean(), integer()) :: t()
  def follow(%{at: nil} = sequence, sorted, _all, _held?, now), do: sort(sequence, sorted, now)

  def follow(%{ids: ids} = sequence, sorted, all, true, _now) do
    known = MapSet.new(all)
    kept = Enum.filter(ids, &(&1 in known))
    shown = MapSet.new(kept)
    ids = kept ++ Enum.reject(sorted, &(&1 in shown))
    %{sequence | ids: ids, differs: ids != sorted}
  end

  def follow(%{ids: ids, at: at} = sequence, sorted, _all, false, now) do
    if now - at >= @again_ms or (ids != sorted and Enum.sort(ids) != Enum.sort(sorted)),
      do: sort(sequence, sorted, now),
      else: %{sequence | differs: false}
  end

  @doc "Takes the places that the browser shows, which may be older than these."
  @spec adopt(t(), shown :: [String.t()]) :: t()
  def adopt(%{ids: ids} = sequence, shown) do
    known = MapSet.new(ids)
    shown = shown |> Enum.filter(&(&1 in known)) |> Enum.uniq()
    placed = MapSet.new(shown)
    %{sequence | ids: shown ++ Enum.reject(ids, &(&1 in placed))}
  end
end
