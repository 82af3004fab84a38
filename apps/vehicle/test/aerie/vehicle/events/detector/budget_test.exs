defmodule Aerie.Vehicle.Events.Detector.BudgetTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, oneof: 1, range: 2]

  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Budget, Observation}

  @second 1_000_000

  # `{type, data}` at times (us), as `{budget, verdicts, reported}`.
  defp spend(events) do
    Enum.reduce(events, {Budget.new(), [], []}, fn {at, type, data}, {budget, verdicts, told} ->
      {budget, more} = Budget.summaries(budget, at)
      {verdict, budget} = Budget.take(budget, type, data, at)
      {budget, [{at, type, data, verdict} | verdicts], told ++ more}
    end)
  end

  defp text(at, severity), do: {at, "statustext", %{"severity" => severity, "text" => "flood"}}

  defp count(verdicts, wanted),
    do: Enum.count(verdicts, fn {_at, _type, _data, verdict} -> verdict == wanted end)

  test "3,000 texts a second for a minute: two a second after the first sixty, six summaries, nothing lost" do
    flood = for n <- 0..179_999, do: text(div(n * @second, 3_000), 6)
    {budget, verdicts, told} = spend(flood)
    assert count(verdicts, :ok) in 177..180
    assert length(told) == 5
    {_budget, rest} = Budget.summaries(budget, 62 * @second)
    assert Enum.sum_by(told ++ rest, & &1["count"]) + count(verdicts, :ok) == 180_000
    assert budget.suppressed == count(verdicts, :over)
  end

  test "no type starves another one, and chatter no urgent texts" do
    flood = for n <- 0..2_999, do: text(n * 300, 6)
    {budget, _verdicts, _told} = spend(flood)

    for {type, data} <- [
          {"armed", %{}},
          {"failsafe", %{}},
          {"statustext", %{"severity" => 0}},
          {"statustext", %{"severity" => 2}},
          {"statustext", %{"severity" => 4}}
        ] do
      assert {:ok, _budget} = Budget.take(budget, type, data, @second)
    end

    assert {:over, _budget} = Budget.take(budget, "statustext", %{"severity" => 5}, 900_000)
  end

  test "a clock that is set back by an hour starves nothing" do
    flood = for n <- 0..99, do: text(3_600 * @second + n, 6)
    {budget, _verdicts, _told} = spend(flood)
    assert {budget, [%{"count" => 40}]} = Budget.summaries(budget, 0)
    assert {:ok, _budget} = Budget.take(budget, "statustext", %{"severity" => 6}, 0)
  end

  test "reports that are fresh and fifty minutes late by turns have no more than their budget" do
    reports =
      for n <- 1..1000 do
        received = 10_000 * @second + n * 1000
        at = if rem(n, 2) == 0, do: received - 3000 * @second, else: received
        Observation.new(:report, at, nil, %{"severity" => 6}, received)
      end

    quiet = Observation.new(:quiet, 10_010 * @second, nil)
    detector = Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))

    {events, _detector} =
      Enum.flat_map_reduce(reports ++ [quiet], detector, fn observation, detector ->
        {detector, events, %{}} = Detector.observe(detector, observation)
        {events, detector}
      end)

    passed = for %{type: "report", time: time} <- events, do: time
    # The whole bucket, and what is added to it in a second.
    assert length(passed) in 60..62
    # Each still has its own time.
    assert Enum.any?(passed, &(&1 < 8_000 * @second))

    assert [%{time: 10_010_000_000, data: %{"of" => "report", "count" => count}}] =
             events -- Enum.filter(events, &(&1.type == "report"))

    assert count + length(passed) == 1000
  end

  test "an event over the budget still changes the detector" do
    flap = for n <- 1..400, do: Observation.new(:state, n * 1000, nil, %{armed: rem(n, 2) == 0, mode: "AUTO"})
    quiet = Observation.new(:quiet, 10 * @second, nil)

    {detector, events} =
      Enum.reduce(
        flap ++ [quiet],
        {Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1})), []},
        fn observation, {detector, events} ->
          {detector, more, %{}} = Detector.observe(detector, observation)
          {detector, events ++ more}
        end
      )

    assert detector.last.armed

    assert Enum.frequencies_by(events, & &1.type) == %{
             "armed" => 60,
             "disarmed" => 60,
             "events.suppressed" => 2
           }

    assert [%{data: %{"of" => "armed", "count" => 140, "last_data" => %{"mode" => "AUTO"}}} | _] =
             Enum.take(events, -2)

    assert Enum.map(events, & &1.seq) == Enum.to_list(1..122)
  end

  test "in any span no kind exceeds its bucket and its rate; everything over the budget is reported" do
    event =
      oneof([
        {:text, range(0, 7)},
        oneof(["armed", "disarmed", "report", "mode_change"])
      ])

    property =
      :proper.forall(list({oneof([range(0, 1000), range(0, 2 * @second)]), event}), fn steps ->
        {events, _end} =
          Enum.map_reduce(steps, 0, fn {gap, event}, now ->
            at = now + gap
            {if(is_tuple(event), do: text(at, elem(event, 1)), else: {at, event, %{}}), at}
          end)

        # Enough of them to be over.
        events = Enum.flat_map(events, &List.duplicate(&1, 40))
        {budget, verdicts, told} = spend(events)
        {_budget, rest} = Budget.summaries(budget, 1_000_000 * @second)

        Enum.sum_by(told ++ rest, & &1["count"]) == count(verdicts, :over) and
          verdicts |> Enum.filter(&(elem(&1, 3) == :ok)) |> Enum.group_by(&kind/1) |> Enum.all?(&within?/1)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
  end

  defp kind({_at, "statustext", %{"severity" => severity}, _}) when severity <= 2, do: :urgent
  defp kind({_at, "statustext", %{"severity" => severity}, _}) when severity <= 4, do: :warning
  defp kind({_at, type, _data, _verdict}), do: type

  # From any one that passed to any later one.
  defp within?({_kind, passed}) do
    times = passed |> Enum.map(&elem(&1, 0)) |> Enum.sort() |> Enum.with_index()

    Enum.all?(Enum.take_every(times, 7), fn {from, i} ->
      Enum.all?(times, fn {to, j} -> j < i or j - i + 1 <= 60 + 2 * (to - from) / @second end)
    end)
  end
end
