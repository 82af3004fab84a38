defmodule MavRouter.Routes.Score do
  @enter 15
  @slight 5
  @readings 3
  @useless 5

  @moduledoc """
  How good a link is, from 0 (useless) to 100 points, and which of several carries.

  - loss: each per cent of lost frames costs two points
  - round trip: each 20 ms costs one point, 30 at most; an unknown round trip costs five
  - age: silence beyond two seconds costs ten points a second

  The link in use is kept until another is better by #{@enter} points, or by #{@slight} for #{@readings} readings in a row, or until
  it has no more than #{@useless}: two radios that are about as good do not take turns.
  """

  @type reading :: %{
          optional(:loss) => float | nil,
          optional(:rtt_ms) => number | nil,
          optional(:age_ms) => non_neg_integer | nil
        }
  @type choice :: %{link: String.t() | nil, challenger: String.t() | nil, readings: non_neg_integer}

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
  # Never heard counts as silent for long.
  defp silence(nil), do: 90
  defp silence(ms), do: max(ms - 2_000, 0) / 100

  @doc "The score at which a link is useless."
  @spec useless() :: number
  def useless, do: @useless

  @doc "No choice made yet."
  @spec none() :: choice
  def none, do: %{link: nil, challenger: nil, readings: 0}

  @doc "The choice after new scores; ties go to the first by name, so that it is always the same."
  @spec choose(choice, %{String.t() => float}) :: choice
  def choose(choice, scores) when map_size(scores) == 0,
    do: %{choice | link: nil, challenger: nil, readings: 0}

  def choose(choice, scores) do
    {best, best_score} = Enum.min_by(scores, fn {link, score} -> {-score, link} end)
    current = scores[choice.link]

    cond do
      best == choice.link -> keep(choice)
      current == nil or current <= @useless -> take(best)
      best_score - current >= @enter -> take(best)
      best_score - current >= @slight -> challenger(choice, best)
      true -> keep(choice)
    end
  end

  defp keep(choice), do: %{choice | challenger: nil, readings: 0}
  defp take(link), do: %{link: link, challenger: nil, readings: 0}

  defp challenger(choice, link) do
    readings = if choice.challenger == link, do: choice.readings + 1, else: 1
    if readings >= @readings, do: take(link), else: %{choice | challenger: link, readings: readings}
  end
end
