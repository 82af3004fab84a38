defmodule Aerie.Vehicle.State.Sampling.Gate do
  @moduledoc """
  Publishes a value that matters, at most once per period. If the period is not over yet, the value is held until then,
  and dropped if a later one does not matter any more. One that does not matter is published when the last one was too
  long ago.

  Without a `threshold` every value that differs from the last one matters. With it, one in which a number named there
  has changed by at least that amount, or has become known or unknown. A name that the group does not have is ignored.
  """
  @behaviour Aerie.Vehicle.State.Sampling

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Sampling

  # 0.58 - 0.57 is a little less than 0.01 in floating point.
  @rounding 1.0e-9

  @enforce_keys [:period_us, :refresh_us, :limits]
  defstruct [:period_us, :refresh_us, :limits, :last, :last_at, :held]

  @impl Sampling
  def new(group, settings, period_us) do
    refresh_us = if settings.refresh_s > 0, do: round(settings.refresh_s * 1_000_000)
    %__MODULE__{period_us: period_us, refresh_us: refresh_us, limits: limits(group, settings)}
  end

  defp limits(_group, %{strategy: :change}), do: nil

  defp limits(group, %{strategy: :threshold, threshold: named}),
    do: for(key <- State.keys(group), amount = named[Atom.to_string(key)], do: {key, amount - @rounding})

  @impl Sampling
  def push(%{last: nil} = gate, at, data), do: give(gate, at, at, data)

  def push(gate, at, data) do
    early? = at - gate.last_at < gate.period_us

    cond do
      matters?(gate.limits, gate.last, data) ->
        if early?, do: {%{gate | held: {at, data}}, []}, else: give(gate, at, at, data)

      gate.refresh_us != nil and at - gate.last_at >= gate.refresh_us ->
        give(gate, at, at, data)

      true ->
        {%{gate | held: nil}, []}
    end
  end

  @impl Sampling
  def expire(%{held: {at, data}} = gate, now) when now - gate.last_at >= gate.period_us,
    do: give(gate, now, at, data)

  def expire(gate, _now), do: {gate, []}

  defp give(gate, now, at, data), do: {%{gate | last: data, last_at: now, held: nil}, [{at, data}]}

  defp matters?(nil, last, now), do: last != now
  defp matters?(limits, last, now), do: Enum.any?(limits, &moved?(&1, last, now))

  defp moved?({key, amount}, last, now) do
    case {Map.get(last, key), Map.get(now, key)} do
      {same, same} -> false
      {a, b} when is_number(a) and is_number(b) -> abs(a - b) >= amount
      _known_or_not -> true
    end
  end
end
