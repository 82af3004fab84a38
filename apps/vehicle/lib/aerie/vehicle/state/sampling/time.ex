defmodule Aerie.Vehicle.State.Sampling.Time do
  @moduledoc """
  Publishes the first value that has all its fields at once, so that a vehicle's position is known when it appears, and after
  that the mean of each period. An incomplete value (the height may come before the position) waits for its period. A period
  without values gives nothing, and the next complete value is a first one again.
  """
  @behaviour Aerie.Vehicle.State.Sampling

  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.State.Sampling.Mean

  defstruct [:period_us, :ends, whole: false, mean: Mean.new()]

  @impl Sampling
  def new(_group, _settings, period_us), do: %__MODULE__{period_us: period_us}

  @impl Sampling
  def push(sampler, at, data) do
    {sampler, samples} = expire(sampler, at)

    if not sampler.whole and whole?(data) do
      begun = %{sampler | ends: at + sampler.period_us, whole: true, mean: Mean.new()}
      {begun, samples ++ [{at, data}]}
    else
      ends = sampler.ends || at + sampler.period_us
      {%{sampler | ends: ends, mean: Mean.add(sampler.mean, at, data)}, samples}
    end
  end

  defp whole?(data), do: not :lists.member(nil, Map.values(data))

  @impl Sampling
  def expire(%{ends: ends} = sampler, now) when ends == nil or now < ends, do: {sampler, []}

  def expire(%{mean: mean} = sampler, now) do
    next = sampler.ends + sampler.period_us
    # After a pause, periods begin with the next value.
    pause = next <= now
    samples = if Mean.count(mean) > 0, do: [{Mean.at(mean), Mean.result(mean)}], else: []
    ends = if not pause, do: next
    {%{sampler | ends: ends, whole: sampler.whole and not pause, mean: Mean.new()}, samples}
  end
end
