defmodule Aerie.Router.Score do
  @moduledoc """
  How good a way is, from 0 (useless) to 100, and which of several is taken.

  - loss: each percent of lost frames costs two points
  - round trip: each 20 ms costs one, 30 at most; an unknown one costs five
  - age: what was silent for more than two seconds costs ten a second

  The way in use is kept until another is better by #{15} points, or for three readings in a row by 5, or until it is worth
  nothing any more: two radios that are about as good do not take turns.
  """

  @enter 15
  @slight 5
  @readings 3
  @useless 5

  @type reading :: %{
          optional(:loss) => float | nil,
          optional(:rtt_ms) => number | nil,
          optional(:age_ms) => non_neg_integer | nil
        }
  @type choice :: %{link: String.t() | nil, rival: String.t() | nil, readings: non_neg_integer}

  @doc "The score of a reading: `loss` 0 to 1, `rtt_ms`, `age_ms` since the last frame; nil or left out: unknown."
  @spec of(reading) :: float
  def of(reading) do
    score = 100 - loss(reading[:loss]) - trip(reading[:rtt_ms]) - silence(reading[:age_ms])
    score |> max(0) |> Kernel./(1)
  end

  defp loss(nil), do: 0
  defp loss(ratio), do: 200 * ratio
  defp trip(nil), do: 5
  defp trip(ms), do: min(ms / 20, 30)
  # Never heard is as good as silent for long.
  defp silence(nil), do: 90
  defp silence(ms), do: max(ms - 2_000, 0) / 100

  @doc "The score at which a way is worth nothing any more."
  @spec useless() :: number
  def useless, do: @useless

  @doc "No choice made yet."
  @spec none() :: choice
  def none, do: %{link: nil, rival: nil, readings: 0}

  @doc "The choice after new scores; ties go to the name that is first in order, so that it is always the same."
  @spec choose(choice, %{String.t() => float}) :: choice
  def choose(choice, scores) when map_size(scores) == 0, do: %{choice | link: nil, rival: nil, readings: 0}

  def choose(choice, scores) do
    {best, best_score} = Enum.min_by(scores, fn {link, score} -> {-score, link} end)
    current = scores[choice.link]

    cond do
      best == choice.link -> keep(choice)
      current == nil or current <= @useless -> take(best)
      best_score - current >= @enter -> take(best)
      best_score - current >= @slight -> rival(choice, best)
      true -> keep(choice)
    end
  end

  defp keep(choice), do: %{choice | rival: nil, readings: 0}
  defp take(link), do: %{link: link, rival: nil, readings: 0}

  defp rival(choice, link) do
    readings = if choice.rival == link, do: choice.readings + 1, else: 1
    if readings >= @readings, do: take(link), else: %{choice | rival: link, readings: readings}
  end
end
