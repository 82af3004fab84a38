defmodule Aerie.Vehicle.State.Sampling.Threshold do
  @moduledoc """
  Publishes a value when a number named under `threshold` has changed by at least that amount since the last one, or has become
  known or unknown. A name that the group does not have is ignored.
  """
  @behaviour Aerie.Vehicle.State.Sampling

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.State.Sampling.Gate

  # 0.58 - 0.57 is a little less than 0.01 in floating point.
  @rounding 1.0e-9

  @impl Sampling
  def new(group, settings, period_us) do
    named = settings.threshold
    limits = for key <- State.keys(group), amount = named[Atom.to_string(key)], do: {key, amount - @rounding}
    {limits, Gate.new(period_us, Sampling.refresh_us(settings))}
  end

  @impl Sampling
  def push({limits, gate}, at, data) do
    {gate, samples} = Gate.push(gate, at, data, fn last, now -> Enum.any?(limits, &moved?(&1, last, now)) end)
    {{limits, gate}, samples}
  end

  @impl Sampling
  def expire({limits, gate}, now) do
    {gate, samples} = Gate.expire(gate, now)
    {{limits, gate}, samples}
  end

  defp moved?({key, amount}, last, now) do
    case {Map.get(last, key), Map.get(now, key)} do
      {same, same} -> false
      {a, b} when is_number(a) and is_number(b) -> abs(a - b) >= amount
      _known_or_not -> true
    end
  end
end
