defmodule MavRouter.Routes.LinkSelector do
  @reach_ms 5_000

  @moduledoc """
  Which of redundant links carries what goes to their vehicles.

  1. The link that `carry` names for the class of message, as long as anything is heard by it. `:all` means each of them.
  2. Otherwise the one that `MavRouter.Endpoints.Meter` found to be the best.
  3. Otherwise the first by name, so that it is always the same one.

  Only those links count by which the target itself was heard within #{div(@reach_ms, 1_000)} s of the latest one: a link may be the best for
  the other vehicles of its group and out of this one's reach.
  """

  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Routes
  alias MavRouter.Routes.Score
  alias MavRouter.Tables

  @doc "Those of a group's links (at least one) that carry a class of message; `carry` is what the owners say."
  @spec links(Tables.t(), String.t(), [String.t()], carry :: String.t() | :all | nil) :: [String.t()]
  def links(_tables, _group, [only], _carry), do: [only]
  def links(_tables, _group, links, :all), do: links

  def links(tables, group, links, carry) do
    best = :ets.lookup_element(tables.scores, {:carrier, group}, 2, nil)

    cond do
      carry in links and useful?(tables, carry) -> [carry]
      best in links -> [best]
      true -> [Enum.min(links)]
    end
  end

  # A link that was never measured may be good.
  defp useful?(tables, link) do
    case :ets.lookup_element(tables.scores, {:score, link}, 2, nil) do
      %{score: score} -> score > Score.useless()
      nil -> true
    end
  end

  @doc "The endpoints by which a system was heard within #{div(@reach_ms, 1_000)} s of the latest one."
  @spec within_reach(Tables.t(), {String.t(), non_neg_integer}, [Endpoint.key()]) :: [Endpoint.key()]
  def within_reach(_tables, _system, [only]), do: [only]

  def within_reach(tables, system, keys) do
    heard = Map.new(keys, &{&1, Routes.heard(tables, system, &1) || 0})
    newest = heard |> Map.values() |> Enum.max()
    Enum.filter(keys, &(newest - heard[&1] <= @reach_ms))
  end

  @doc "What `carry` of any of the owners says about a class."
  @spec configured([%{:carry => map, optional(any) => any}], TrafficClass.class()) :: String.t() | :all | nil
  def configured(owners, class), do: Enum.find_value(owners, & &1.carry[class])
end
