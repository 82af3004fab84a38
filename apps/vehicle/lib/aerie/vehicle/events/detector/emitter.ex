defmodule Aerie.Vehicle.Events.Detector.Emitter do
  @moduledoc """
  Makes events of steps: each event that is within the budget gets the next number. The changes of the detector are made in
  any case.
  """

  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Budget, Step}

  @doc """
  The detector after these steps, which happened at `moment` unless they say otherwise, and their events in order.

  The budget is spent by when the gateway learned of them: the vehicle says when a report happened, and would refill its budget
  with times that go to and fro.
  """
  @spec emit(Detector.t(), [Step.t()], Step.moment()) :: {Detector.t(), [Event.t()]}
  def emit(detector, steps, %{received: now} = moment) do
    {budget, suppressed} = Budget.summaries(detector.budget, now)
    told = %{moment | at: now, where: nil}
    summaries = for data <- suppressed, do: %{Step.event("events.suppressed", data) | moment: told}
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
