defmodule Aerie.Vehicle.State.Sampling.Aggregate do
  @moduledoc """
  The mean of each period under the usual keys, with `min` and `max` of each number and the number of `samples`. The periods
  are those of `Aerie.Vehicle.State.Sampling.Time`.

  The minimum and maximum of an angle are those of its numbers, not on the circle.
  """
  @behaviour Aerie.Vehicle.State.Sampling

  alias Aerie.Vehicle.State.Sampling

  defstruct [:time, min: %{}, max: %{}, samples: 0]

  @impl Sampling
  def new(group, settings, period_us), do: %__MODULE__{time: Sampling.Time.new(group, settings, period_us)}

  @impl Sampling
  def push(sampler, at, data) do
    {sampler, samples} = step(sampler, Sampling.Time.expire(sampler.time, at))
    numbers = Map.filter(data, fn {_key, value} -> is_number(value) end)

    sampler = %{
      sampler
      | min: Map.merge(sampler.min, numbers, fn _key, a, b -> min(a, b) end),
        max: Map.merge(sampler.max, numbers, fn _key, a, b -> max(a, b) end),
        samples: sampler.samples + 1
    }

    {sampler, first} = step(sampler, Sampling.Time.push(sampler.time, at, data))
    {sampler, samples ++ first}
  end

  @impl Sampling
  def expire(sampler, now), do: step(sampler, Sampling.Time.expire(sampler.time, now))

  defp step(sampler, {time, []}), do: {%{sampler | time: time}, []}

  defp step(sampler, {time, [{at, mean}]}) do
    data = Map.merge(mean, %{min: sampler.min, max: sampler.max, samples: sampler.samples})
    {%__MODULE__{time: time}, [{at, data}]}
  end
end
