defmodule Aerie.Vehicle.Sampling do
  @moduledoc """
  Full rate in, a configured rate out: what of each state group is published. A pure value.

  A group's strategy:

  | strategy    | gives                                                                                             |
  |-------------|---------------------------------------------------------------------------------------------------|
  | `:time`     | once per period the mean of the period; angles are averaged on the circle, what is no number last  |
  | `:change`   | a value that differs from the one given last, at most `hz` times a second                         |
  | `:threshold` | a value of which a number named in `threshold` moved by at least its amount, at most `hz` a second |
  | `:aggregate` | once per period the mean, with `min`, `max` and the number of `samples`                           |

  The first value of a group is given at once, by all of them; by `:time` the first one that has all its fields.

  After `refresh_s` seconds a value is given although nothing moved (0: never), but only one that came since: a value is
  never repeated for a vehicle that says nothing.

  Settings of a group: `%{strategy: atom, hz: float, threshold: %{"key" => amount}, refresh_s: float}`, as
  `Aerie.Config` has them under `sampling.groups`; missing ones have defaults.
  """

  alias Aerie.Vehicle.Sampling.{Aggregate, Change, Threshold, Time}
  alias Aerie.Vehicle.State

  @type data :: map()
  @type sample :: {at :: integer(), data()}

  @doc "A sampler of a group; `period_us` is the shortest time between two samples that it gives."
  @callback new(State.group(), settings :: map(), period_us :: pos_integer()) :: term()
  @doc "A value that came `at`."
  @callback push(term(), integer(), data()) :: {term(), [sample()]}
  @doc "It is `now`, and no value came."
  @callback expire(term(), integer()) :: {term(), [sample()]}

  @strategies %{time: Time, change: Change, threshold: Threshold, aggregate: Aggregate}
  @defaults %{
    position: %{strategy: :time},
    attitude: %{strategy: :time},
    velocity: %{strategy: :time},
    battery: %{strategy: :threshold, threshold: %{"remaining" => 0.01}},
    gps: %{strategy: :change, hz: 0.5},
    mode: %{strategy: :change, hz: 10.0},
    health: %{strategy: :change},
    home: %{strategy: :change, refresh_s: 60.0},
    mission: %{strategy: :change, refresh_s: 60.0},
    rc: %{strategy: :time, hz: 0.2},
    link: %{strategy: :aggregate, hz: 0.2}
  }

  @type t :: %{State.group() => {module(), term()}}

  @doc "The samplers of all groups."
  @spec new(%{State.group() => map()}) :: t()
  def new(settings \\ %{}) do
    Map.new(State.groups(), fn group ->
      settings = @defaults |> Map.fetch!(group) |> Map.merge(Map.get(settings, group, %{}))
      module = Map.fetch!(@strategies, settings.strategy)
      {group, {module, module.new(group, settings, round(1_000_000 / Map.get(settings, :hz, 1.0)))}}
    end)
  end

  @doc "A group's value that came `at`; gives what is to be published."
  @spec push(t(), State.group(), integer(), data()) :: {t(), [sample()]}
  def push(samplers, group, at, data) do
    {module, sampler} = Map.fetch!(samplers, group)
    {sampler, samples} = module.push(sampler, at, data)
    {%{samplers | group => {module, sampler}}, samples}
  end

  @doc "What is to be published because it is `now`."
  @spec expire(t(), integer()) :: {t(), [{State.group(), sample()}]}
  def expire(samplers, now) do
    Enum.reduce(samplers, {samplers, []}, fn {group, {module, sampler}}, {samplers, due} ->
      case module.expire(sampler, now) do
        {^sampler, []} ->
          {samplers, due}

        {sampler, samples} ->
          {%{samplers | group => {module, sampler}}, Enum.map(samples, &{group, &1}) ++ due}
      end
    end)
  end

  @doc "The refresh time of settings in microseconds, nil for never."
  @spec refresh_us(map()) :: pos_integer() | nil
  def refresh_us(settings) do
    case Map.get(settings, :refresh_s, 30.0) do
      seconds when seconds > 0 -> round(seconds * 1_000_000)
      _never -> nil
    end
  end
end
