defmodule Aerie.Router.Carrier do
  @moduledoc """
  Which of redundant links carries what goes to their vehicles.

  1. the link that `carry` names for the class of message, as long as anything is heard by it; `:all`: each of them
  2. else the one that `Aerie.Router.Meter` found to be the best
  3. else the first by name: always the same one

  Only among those by which the addressee itself was heard about as lately as by any (#{5} s): a link may be the best for the
  other vehicles of its group and out of this one's reach.
  """

  alias Aerie.Router.Classify
  alias Aerie.Router.Routes
  alias Aerie.Router.Score
  alias Aerie.Router.Tables

  @reach_ms 5_000

  @doc "Of a group's links, of which there is at least one, those that carry a class of message."
  @spec links(Tables.t(), String.t(), [String.t()], carry :: String.t() | :all | nil) :: [String.t()]
  def links(_tables, _group, [only], _carry), do: [only]
  def links(_tables, _group, links, :all), do: links

  def links(tables, group, links, carry) do
    best = :ets.lookup_element(tables.scores, {:pick, group}, 2, nil)

    cond do
      carry in links and useful?(tables, carry) -> [carry]
      best in links -> [best]
      true -> [Enum.min(links)]
    end
  end

  # What was never measured may be good.
  defp useful?(tables, link) do
    case :ets.lookup_element(tables.scores, {:score, link}, 2, nil) do
      %{score: score} -> score > Score.useless()
      nil -> true
    end
  end

  @doc "Of ways to a system those by which it was heard about as lately as by any."
  @spec within_reach(Tables.t(), {String.t(), non_neg_integer}, [Routes.way()]) :: [Routes.way()]
  def within_reach(_tables, _system, [only]), do: [only]

  def within_reach(tables, system, ways) do
    heard = Map.new(ways, &{&1, Routes.heard(tables, system, &1) || 0})
    newest = heard |> Map.values() |> Enum.max()
    Enum.filter(ways, &(newest - heard[&1] <= @reach_ms))
  end

  @doc "What `carry` of any of the owners says about a class."
  @spec configured([%{:carry => map, optional(any) => any}], Classify.class()) :: String.t() | :all | nil
  def configured(owners, class), do: Enum.find_value(owners, & &1.carry[class])
end
