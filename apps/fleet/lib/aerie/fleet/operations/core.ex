defmodule Aerie.Fleet.Operations.Core do
  @moduledoc """
  An operation on many vehicles, without the process: which begin when, what became of each, and when no more begin.

  The vehicles go in steps of `:step`. A step begins when all of the one before have their end and `:pause_ms` have
  passed, unless more than `:halt_ratio` of all that have their end failed: then the operation is halted. Each vehicle
  begins at most once.

  | state | begins | under way | afterwards |
  |---|---|---|---|
  | `running` | yes | yes | `done`, or another |
  | `paused` | no | comes to its end | `continue/1`, `stop/1` |
  | `halted`, `interrupted` | no | nothing | `continue/1` with those that have not begun, or `stop/1` |
  | `stopped` | never again | comes to its end, unless it was `abort/1` | |

  Actions: `{:begin, vehicle}`; `{:cancel, vehicle}`, whose work is given up; `{:wait, ms, n}`, after which `waited/2`
  is called with that number.
  """

  @enforce_keys [:waiting, :step, :pause_ms, :halt_ratio]
  defstruct [:waiting, :step, :pause_ms, :halt_ratio] ++
              [state: :running, under_way: MapSet.new(), results: %{}, steps: 0, forgiven: 0]

  @typedoc "`:reason` is a sentence for people, nil for a plain success."
  @type result :: %{verdict: :ok | :failed, status: String.t(), reason: String.t() | nil}
  @type state :: :running | :paused | :stopped | :halted | :done | :interrupted
  @type t :: %__MODULE__{
          waiting: [String.t()],
          step: pos_integer(),
          pause_ms: non_neg_integer(),
          halt_ratio: float(),
          state: state(),
          under_way: MapSet.t(String.t()),
          results: %{String.t() => result()},
          steps: non_neg_integer(),
          forgiven: non_neg_integer()
        }
  @type action ::
          {:begin, String.t()} | {:cancel, String.t()} | {:wait, non_neg_integer(), pos_integer()}

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

  @doc "The time between step `n` and the next one is over."
  @spec waited(t(), n :: pos_integer()) :: {t(), [action()]}
  def waited(%{state: :running, steps: n, waiting: [_ | _]} = core, n) do
    if MapSet.size(core.under_way) == 0, do: step(core), else: {core, []}
  end

  def waited(core, _late), do: {core, []}

  @doc "Nothing begins until `continue/1`."
  @spec pause(t()) :: {t(), [action()]}
  def pause(%{state: :running} = core), do: {%{core | state: :paused}, []}
  def pause(core), do: {core, []}

  @doc "Goes on with those that have not begun, whatever has failed. The time between two steps counts from now on."
  @spec continue(t()) :: {t(), [action()]}
  def continue(%{state: state} = core) when state in [:paused, :halted, :interrupted],
    do: next(%{core | state: :running, forgiven: failed(core)})

  def continue(core), do: {core, []}

  @doc "Nothing begins any more."
  @spec stop(t()) :: {t(), [action()]}
  def stop(%{state: state} = core) when state not in [:done, :stopped], do: {%{core | state: :stopped}, []}
  def stop(core), do: {core, []}

  @doc "None begins any more, and what is under way is given up: another operation brings back the others."
  @spec abort(t()) :: {t(), [action()]}
  def abort(core) do
    {stopped, []} = stop(core)
    given_up = given_up(stopped, "it was given up: the operation was aborted")
    {given_up, for(vehicle <- core.under_way, do: {:cancel, vehicle})}
  end

  @doc "The process that kept it is gone: what was under way has no end that anybody knows."
  @spec interrupted(t()) :: t()
  def interrupted(core) do
    state = if core.state in [:running, :paused], do: :interrupted, else: core.state
    given_up(%{core | state: state}, "the gateway's operations were restarted meanwhile")
  end

  defp given_up(core, reason) do
    unknown = %{verdict: :failed, status: "unknown", reason: reason}
    results = Map.merge(core.results, Map.new(core.under_way, &{&1, unknown}))
    %{core | results: results, under_way: MapSet.new()}
  end

  @doc "Whether nothing happens any more, unless somebody continues it."
  @spec over?(t()) :: boolean()
  def over?(core), do: core.state not in [:running, :paused] and MapSet.size(core.under_way) == 0

  @doc "Those that have begun, in no order."
  @spec begun(t()) :: [String.t()]
  def begun(core), do: MapSet.to_list(core.under_way) ++ Map.keys(core.results)

  @doc "How many failed."
  @spec failed(t()) :: non_neg_integer()
  def failed(core), do: Enum.count(core.results, fn {_vehicle, result} -> result.verdict == :failed end)

  @doc "Whether more failed than may, so that no step begins."
  @spec failing?(t()) :: boolean()
  def failing?(core),
    do: failed(core) - core.forgiven > core.halt_ratio * (map_size(core.results) - core.forgiven)

  defp next(%{state: :running, under_way: under_way} = core) do
    cond do
      MapSet.size(under_way) > 0 -> {core, []}
      core.waiting == [] -> {%{core | state: :done}, []}
      failing?(core) -> {%{core | state: :halted}, []}
      core.pause_ms > 0 and core.steps > 0 -> {core, [{:wait, core.pause_ms, core.steps}]}
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
