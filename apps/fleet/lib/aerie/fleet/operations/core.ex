defmodule Aerie.Fleet.Operations.Core do
  @moduledoc """
  An operation on many vehicles, without the process: which begin when, what became of each, and when no more begin.

  The vehicles go in steps of `:step`. A step begins when all of the one before have their end and `:pause_ms` have passed, unless
  more than `:halt_ratio` of all that have their end failed: then the operation is halted, and nothing begins any more. `stop/1` ends it
  at once; what is under way comes to its end. Each vehicle begins at most once.

  Actions: `{:begin, vehicle}`; `{:pause, ms, n}`, after which `paused/2` is called with that number.
  """

  @enforce_keys [:waiting, :step, :pause_ms, :halt_ratio]
  defstruct [:waiting, :step, :pause_ms, :halt_ratio] ++
              [state: :running, under_way: MapSet.new(), results: %{}, steps: 0]

  @typedoc "`:reason` is a sentence for people, nil for a plain success."
  @type result :: %{verdict: :ok | :failed, status: String.t(), reason: String.t() | nil}
  @type state :: :running | :stopped | :halted | :done | :interrupted
  @type t :: %__MODULE__{
          waiting: [String.t()],
          step: pos_integer(),
          pause_ms: non_neg_integer(),
          halt_ratio: float(),
          state: state(),
          under_way: MapSet.t(String.t()),
          results: %{String.t() => result()},
          steps: non_neg_integer()
        }
  @type action :: {:begin, String.t()} | {:pause, non_neg_integer(), pos_integer()}

  @doc "An operation and its first step."
  @spec new([String.t(), ...], %{step: pos_integer(), pause_ms: non_neg_integer(), halt_ratio: float()}) ::
          {t(), [action()]}
  def new(vehicles, plan),
    do: step(struct!(__MODULE__, Map.put(plan, :waiting, Enum.uniq(vehicles))))

  @doc "A vehicle has its end. A second one is ignored."
  @spec ended(t(), String.t(), result()) :: {t(), [action()]}
  def ended(core, vehicle, result) do
    if vehicle in core.under_way do
      %{
        core
        | under_way: MapSet.delete(core.under_way, vehicle),
          results: Map.put(core.results, vehicle, result)
      }
      |> next()
    else
      {core, []}
    end
  end

  @doc "The pause after step `n` is over."
  @spec paused(t(), n :: pos_integer()) :: {t(), [action()]}
  def paused(%{state: :running, steps: n, waiting: [_ | _]} = core, n) do
    if MapSet.size(core.under_way) == 0, do: step(core), else: {core, []}
  end

  def paused(core, _late), do: {core, []}

  @doc "Nothing begins any more."
  @spec stop(t()) :: {t(), [action()]}
  def stop(%{state: :running} = core), do: {%{core | state: :stopped}, []}
  def stop(core), do: {core, []}

  @doc "The process that kept it is gone: what was under way has no end that anybody knows."
  @spec interrupted(t()) :: t()
  def interrupted(core) do
    unknown = %{
      verdict: :failed,
      status: "unknown",
      reason: "the gateway's operations were restarted meanwhile"
    }

    results = Map.merge(core.results, Map.new(core.under_way, &{&1, unknown}))
    state = if over?(core), do: core.state, else: :interrupted
    %{core | results: results, under_way: MapSet.new(), state: state}
  end

  @doc "Whether nothing happens any more."
  @spec over?(t()) :: boolean()
  def over?(core), do: core.state != :running and MapSet.size(core.under_way) == 0

  @doc "How many failed."
  @spec failed(t()) :: non_neg_integer()
  def failed(core), do: Enum.count(core.results, fn {_vehicle, result} -> result.verdict == :failed end)

  defp next(%{state: :running, under_way: under_way} = core) do
    cond do
      MapSet.size(under_way) > 0 -> {core, []}
      core.waiting == [] -> {%{core | state: :done}, []}
      failed(core) > core.halt_ratio * map_size(core.results) -> {%{core | state: :halted}, []}
      core.pause_ms > 0 -> {core, [{:pause, core.pause_ms, core.steps}]}
      true -> step(core)
    end
  end

  defp next(core), do: {core, []}

  defp step(core) do
    {now, later} = Enum.split(core.waiting, core.step)
    core = %{core | waiting: later, under_way: MapSet.new(now), steps: core.steps + 1}
    {core, for(vehicle <- now, do: {:begin, vehicle})}
  end
end
