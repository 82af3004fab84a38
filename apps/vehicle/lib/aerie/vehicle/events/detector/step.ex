defmodule Aerie.Vehicle.Events.Detector.Step do
  @moduledoc "An event to be, together with the change of the detector that goes with it."

  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Budget

  @enforce_keys [:type]
  defstruct [:type, data: %{}, changes: [], moment: nil]

  @typedoc """
  When and where something happened: unix us, the vehicle's clock (ms), its position as event data; and when the gateway learned
  of it.
  """
  @type moment :: %{
          at: integer(),
          boot_ms: non_neg_integer() | nil,
          where: map() | nil,
          received: integer()
        }
  @typedoc """
  `type` is nil for a change of the detector alone; `changes` are fields of the detector; `moment` is set if the event
  happened earlier than what showed it.
  """
  @type t :: %__MODULE__{type: String.t() | nil, data: map(), changes: keyword(), moment: moment() | nil}

  @doc "An event."
  @spec event(String.t(), map(), keyword()) :: t()
  def event(type, data \\ %{}, changes \\ []), do: %__MODULE__{type: type, data: data, changes: changes}

  @doc "A change of the detector without an event."
  @spec change(keyword()) :: t()
  def change(changes), do: %__MODULE__{type: nil, changes: changes}

  @doc "The time between two moments as events give it: seconds, to a tenth."
  @spec seconds(from :: integer(), to :: integer()) :: float()
  def seconds(from, to), do: Float.round(max(to - from, 0) / 1_000_000, 1)

  @doc """
  The detector after these steps, which happened at `moment` unless they say otherwise, and their events in order.

  Each event that is within the budget gets the next number. The changes of the detector are made in any case. The
  budget is spent by when the gateway learned of them: the vehicle says when a report happened, and would refill its
  budget with times that go to and fro.
  """
  @spec emit(Detector.t(), [t()], moment()) :: {Detector.t(), [Event.t()]}
  def emit(detector, steps, %{received: now} = moment) do
    {budget, suppressed} = Budget.summaries(detector.budget, now)
    told = %{moment | at: now, where: nil}
    summaries = for data <- suppressed, do: %{event("events.suppressed", data) | moment: told}
    start = Enum.reduce(summaries, {%{detector | budget: budget}, []}, &number/2)

    {detector, events} =
      Enum.reduce(steps, start, fn step, {detector, events} ->
        step = %{step | moment: step.moment || moment}
        step = if where = step.moment.where, do: put_in(step.data["position"], where), else: step
        {verdict, budget} = spend(detector.budget, step, now)
        step = if verdict == :ok, do: step, else: %{step | type: nil}
        number(step, {%{detector | budget: budget}, events})
      end)

    {detector, Enum.reverse(events)}
  end

  defp spend(budget, %{type: nil}, _now), do: {:ok, budget}
  defp spend(budget, step, now), do: Budget.take(budget, step.type, step.data, now)

  defp number(%{type: nil} = step, {detector, events}), do: {struct!(detector, step.changes), events}

  defp number(%{type: type, data: data, moment: moment} = step, {detector, events}) do
    seq = detector.seq + 1
    event = Event.new(detector.vehicle, type, seq, moment.at, moment.boot_ms, data)
    {struct!(detector, [seq: seq] ++ step.changes), [event | events]}
  end
end
