defmodule Aerie.Fleet.Diagnosis.Trend do
  @moduledoc """
  What changed lately. Counters only grow, so a rule needs to know by how much they grew in the last minute. A pure value.

  It adds to the facts:

  | key | value |
  |---|---|
  | `:seconds` | the length of the period that `:grown` covers; 0 at first |
  | `:grown` | `%{{:link, id} \| {:endpoints, owner} => %{counter => n}}`, without counters that did not grow |
  | `:online_ms` | `%{vehicle id => ms}` for which each vehicle has been online |
  | `:clock_steps` | `[{ms ago, us}]`: by how much this machine's clock was set within ten minutes |
  """

  alias Aerie.Fleet.Diagnosis.Observations
  alias Aerie.Base.Timing.HostClock

  @window_ms 60_000
  @apart_ms 5_000
  @steps_ms 600_000
  @max_steps 8
  @max_online 4_096

  defstruct samples: [], online: %{}, offset: nil, steps: []

  @typedoc "`samples`: newest first, `{mono, counters}`; `online`: since when (mono); `steps`: `{mono, us}`."
  @type t :: %__MODULE__{}

  @doc "A trend that has seen no facts."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Adds what changed to the facts."
  @spec step(t(), Observations.t()) :: {Observations.t(), t()}
  def step(trend, %{mono: mono} = facts) do
    counters = counters(facts)
    recent = Enum.filter(trend.samples, fn {at, _counters} -> mono - at <= @window_ms end)
    trend = %{trend | samples: keep(recent, mono, counters)} |> clock(facts) |> online(facts)
    {since, base} = List.last(recent) || {mono, counters}

    facts =
      Map.merge(facts, %{
        seconds: div(mono - since, 1000),
        grown: grown(base, counters),
        online_ms: Map.new(trend.online, fn {id, since} -> {id, mono - since} end),
        clock_steps: for({at, us} <- trend.steps, do: {mono - at, us})
      })

    {facts, trend}
  end

  # Samples are kept apart, so that a minute has a dozen of them however often somebody asks.
  defp keep([{at, _counters} | _] = samples, mono, _new) when mono - at < @apart_ms, do: samples
  defp keep(samples, mono, counters), do: [{mono, counters} | samples]

  defp counters(%{links: links, endpoints: endpoints}) do
    of_links =
      for %{counters: counters} = link <- links, into: %{} do
        plain = if is_struct(counters), do: Map.from_struct(counters), else: counters
        rejected = get_in(link, [Access.key(:signing), Access.key(:rejected)]) || 0
        {{:link, link.id}, plain |> Map.delete(:messages) |> Map.put(:rejected, rejected)}
      end

    Enum.reduce(endpoints, of_links, fn %{owner: owner, counters: counters}, all ->
      Map.update(all, {:endpoints, owner}, counters, &Map.merge(&1, counters, fn _key, a, b -> a + b end))
    end)
  end

  # A new subject has no earlier value; a counter that restarted counts from 0.
  defp grown(base, counters) do
    for {key, now} <- counters, before = base[key], into: %{} do
      {key, for({name, n} <- now, more = more(n, before[name] || 0), more > 0, into: %{}, do: {name, more})}
    end
  end

  defp more(n, before) when n >= before, do: n - before
  defp more(n, _before), do: n

  defp clock(%{offset: before} = trend, %{clock_offset: offset, mono: mono}) do
    step = if before, do: HostClock.step(before, offset), else: 0
    steps = Enum.filter(trend.steps, fn {at, _us} -> mono - at <= @steps_ms end)
    steps = if step == 0, do: steps, else: Enum.take([{mono, step} | steps], @max_steps)
    %{trend | offset: offset, steps: steps}
  end

  defp online(trend, %{vehicles: vehicles, mono: mono}) do
    online =
      for %{id: id, status: :online} <- Enum.take(vehicles, @max_online),
          into: %{},
          do: {id, Map.get(trend.online, id, mono)}

    %{trend | online: online}
  end
end
