defmodule Aerie.Vehicle.Sampling.Time do
  @moduledoc """
  The first value as it is, at once, and the mean over each period from there on. A period without values gives nothing,
  and the next value after it is a first one again: who waits for a vehicle has its position when it comes.
  """
  @behaviour Aerie.Vehicle.Sampling

  alias Aerie.Vehicle.Sampling
  alias Aerie.Vehicle.Sampling.Mean

  defstruct [:period_us, :ends, mean: Mean.new()]

  @impl Sampling
  def new(_group, _settings, period_us), do: %__MODULE__{period_us: period_us}

  @impl Sampling
  def push(sampler, at, data) do
    {sampler, samples} = expire(sampler, at)

    if sampler.ends == nil,
      do: {%{sampler | ends: at + sampler.period_us}, samples ++ [{at, data}]},
      else: {%{sampler | mean: Mean.add(sampler.mean, at, data)}, samples}
  end

  @impl Sampling
  def expire(%{ends: ends} = sampler, now) when ends == nil or now < ends, do: {sampler, []}

  def expire(%{mean: mean} = sampler, now) do
    next = sampler.ends + sampler.period_us
    # After a pause the periods begin anew with the next value.
    ends = if next > now, do: next
    samples = if Mean.count(mean) > 0, do: [{Mean.at(mean), Mean.result(mean)}], else: []
    {%{sampler | ends: ends, mean: Mean.new()}, samples}
  end
end
