defmodule Aerie.Vehicle.State.Sampling do
  @moduledoc """
  Reduces the full rate of each state group to the configured rate of publishing. A pure value.

  A group's strategy:

  | strategy     | publishes                                                                                          |
  |--------------|----------------------------------------------------------------------------------------------------|
  | `:time`      | once per period the mean of the period; angles are averaged on the circle, for anything but a number the last value counts |
  | `:change`    | a value that differs from the one published last, at most `hz` times a second                      |
  | `:threshold` | a value in which a number named in `threshold` changed by at least that amount, at most `hz` times a second |
  | `:aggregate` | once per period the mean, with `min`, `max` and the number of `samples`                            |

  All of them publish the first value of a group at once; `:time` the first one that has all its fields.

  After `refresh_s` seconds a value is published even without a change (0: never), but only a new one: the values of a silent
  vehicle are not repeated.

  Settings of a group: `%{strategy: atom, hz: float, threshold: %{"key" => amount}, refresh_s: float}`, as
  in `Aerie.Vehicle.State.Sampling.Settings`, which also has the defaults.
  """

  alias Aerie.Vehicle.State.Sampling.{Aggregate, Gate, Settings, Time}
  alias Aerie.Vehicle.State

  @type data :: map()
  @type sample :: {at :: integer(), data()}

  @doc "A sampler of a group; `period_us` is the shortest time between two samples."
  @callback new(State.group(), settings :: map(), period_us :: pos_integer()) :: term()
  @doc "A value that came `at`."
  @callback push(term(), integer(), data()) :: {term(), [sample()]}
  @doc "The publications due at `now` without a new value."
  @callback expire(term(), integer()) :: {term(), [sample()]}

  @strategies %{time: Time, change: Gate, threshold: Gate, aggregate: Aggregate}

  @type t :: %{State.group() => {module(), term()}}

  @doc "The samplers of all groups."
  @spec new(%{State.group() => map()}) :: t()
  def new(settings \\ %{}) do
    Map.new(Settings.groups(settings), fn {group, settings} ->
      module = Map.fetch!(@strategies, settings.strategy)
      {group, {module, module.new(group, settings, round(1_000_000 / settings.hz))}}
    end)
  end

  @doc "A group's value that came `at`; returns what is to be published."
  @spec push(t(), State.group(), integer(), data()) :: {t(), [sample()]}
  def push(samplers, group, at, data) do
    {module, sampler} = Map.fetch!(samplers, group)
    {sampler, samples} = module.push(sampler, at, data)
    {%{samplers | group => {module, sampler}}, samples}
  end

  @doc "The publications due at `now`."
  @spec expire(t(), integer()) :: {t(), [{State.group(), sample()}]}
  def expire(samplers, now) do
    changed =
      for {group, {module, sampler}} <- Map.to_list(samplers),
          {next, samples} = module.expire(sampler, now),
          next != sampler,
          do: {group, {module, next}, samples}

    expired(changed, samplers, [])
  end

  # On most ticks nothing is due.
  defp expired([], samplers, due), do: {samplers, due}

  defp expired([{group, sampler, samples} | rest], samplers, due),
    do: expired(rest, %{samplers | group => sampler}, Enum.map(samples, &{group, &1}) ++ due)
end
