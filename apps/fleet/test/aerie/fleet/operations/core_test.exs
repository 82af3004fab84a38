defmodule Aerie.Fleet.Operations.CoreTest do
  @moduledoc "Which vehicles of an operation begin when, and when none does any more."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.Core

  @ok %{verdict: :ok, status: "completed", reason: nil}
  @failed %{verdict: :failed, status: "denied", reason: "no"}

  defp ids(n), do: for(i <- 1..n, do: "V-#{i}")
  defp plan(step, more \\ []), do: Map.merge(%{step: step, pause_ms: 0, halt_ratio: 1.0}, Map.new(more))
  defp begun(actions), do: for({:begin, id} <- actions, do: id)

  defp all(core, vehicles, result) do
    Enum.reduce(vehicles, {core, []}, fn id, {core, actions} ->
      {core, more} = Core.ended(core, id, result)
      {core, actions ++ more}
    end)
  end

  test "step by step, each when the one before has its end; then it is done" do
    {core, actions} = Core.new(ids(5), plan(2))
    assert begun(actions) == ["V-1", "V-2"]
    assert {core, []} = Core.ended(core, "V-2", @ok)
    assert {core, actions} = Core.ended(core, "V-1", @failed)
    assert begun(actions) == ["V-3", "V-4"]
    # A second end, and one of a vehicle that has not begun.
    assert {^core, []} = Core.ended(core, "V-1", @ok)
    assert {^core, []} = Core.ended(core, "V-5", @ok)
    assert {core, actions} = all(core, ["V-3", "V-4"], @ok)
    assert begun(actions) == ["V-5"]
    refute Core.over?(core)
    assert {%{state: :done} = core, []} = Core.ended(core, "V-5", @ok)
    assert Core.over?(core) and Core.failed(core) == 1 and map_size(core.results) == 5
  end

  test "a pause between steps, of which only the last counts" do
    {core, _first} = Core.new(ids(3), plan(1, pause_ms: 500))
    assert {core, [{:wait, 500, 1}]} = Core.ended(core, "V-1", @ok)
    assert {core, [{:begin, "V-2"}]} = Core.waited(core, 1)
    assert {^core, []} = Core.waited(core, 1)
    assert {core, [{:wait, 500, 2}]} = Core.ended(core, "V-2", @ok)
    assert {%{state: :stopped} = core, []} = Core.stop(core)
    assert Core.over?(core)
    assert {^core, []} = Core.waited(core, 2)
  end

  test "too many failures at the end of a step halt it; a stop lets what is under way come to its end" do
    {core, _first} = Core.new(ids(8), plan(4, halt_ratio: 0.25))
    {core, []} = all(core, ["V-1", "V-2", "V-3"], @ok)
    assert {core, [_, _, _, _]} = Core.ended(core, "V-4", @failed)
    assert {%{state: :stopped} = core, []} = Core.stop(core)
    refute Core.over?(core)
    assert {core, []} = all(core, ids(8) -- ids(4), @ok)
    assert Core.over?(core) and core.state == :stopped

    {core, _first} = Core.new(ids(8), plan(4, halt_ratio: 0.25))
    {core, []} = all(core, ["V-1", "V-2"], @failed)
    assert {%{state: :halted} = core, []} = all(core, ["V-3", "V-4"], @ok)
    assert Core.over?(core) and core.waiting == ids(8) -- ids(4)
  end

  test "interrupted, what was under way is unknown" do
    {core, _first} = Core.new(ids(3), plan(2))
    {core, []} = Core.ended(core, "V-1", @ok)
    core = Core.interrupted(core)
    assert core.state == :interrupted and Core.over?(core)
    assert %{"V-1" => @ok, "V-2" => %{status: "unknown"}} = core.results
    assert Core.interrupted(core) == core
  end

  test "paused, nothing begins until it goes on, which takes the time between two steps" do
    {core, _first} = Core.new(ids(4), plan(1, pause_ms: 500))
    assert {%{state: :paused} = core, []} = Core.pause(core)
    assert {%{state: :paused} = core, []} = Core.ended(core, "V-1", @ok)
    assert {^core, []} = Core.waited(core, 1)
    refute Core.over?(core)
    assert {%{state: :running} = core, [{:wait, 500, 1}]} = Core.continue(core)
    assert {core, [{:begin, "V-2"}]} = Core.waited(core, 1)
    {core, []} = Core.pause(core)
    # While the second is under way, the third is not begun.
    assert {%{state: :running} = core, []} = Core.continue(core)
    assert {core, [{:wait, 500, 2}]} = Core.ended(core, "V-2", @ok)
    assert {%{state: :stopped} = core, []} = core |> Core.pause() |> elem(0) |> Core.stop()
    assert {^core, []} = Core.continue(core)
  end

  test "halted or interrupted, it goes on with those that have not begun; what has failed does not halt it again" do
    {core, _first} = Core.new(ids(4), plan(1, halt_ratio: 0.0))
    assert {%{state: :halted} = core, []} = Core.ended(core, "V-1", @failed)
    assert {core, [{:begin, "V-2"}]} = Core.continue(core)
    core = Core.interrupted(core)
    assert Core.begun(core) -- ["V-1", "V-2"] == []
    assert {core, [{:begin, "V-3"}]} = Core.continue(core)
    assert {core, [{:begin, "V-4"}]} = Core.ended(core, "V-3", @ok)
    assert {%{state: :done}, []} = Core.ended(core, "V-4", @ok)
  end

  test "aborted, what is under way is given up and nothing begins" do
    {core, _first} = Core.new(ids(4), plan(2))
    {core, []} = Core.ended(core, "V-1", @ok)
    assert {%{state: :stopped} = core, [{:cancel, "V-2"}]} = Core.abort(core)
    assert Core.over?(core)
    assert %{"V-1" => @ok, "V-2" => %{status: "unknown"}} = core.results
    assert {^core, []} = Core.ended(core, "V-2", @ok)
    assert {^core, []} = Core.abort(core)
  end

  test "whatever comes: each vehicle begins once, never more than a step, none unless it runs, none after a stop" do
    event =
      :proper_types.frequency([
        {12, {:ended, :proper_types.integer(1, 12), :proper_types.boolean()}},
        {3, {:paused, :proper_types.integer(1, 6)}},
        {2, :proper_types.oneof([:pause, :continue, :interrupted])},
        {1, :proper_types.oneof([:stop, :abort])}
      ])

    property =
      :proper.forall(
        {:proper_types.integer(1, 12), :proper_types.integer(1, 5), :proper_types.oneof([0, 700]),
         :proper_types.oneof([0.0, 0.3, 1.0]), :proper_types.list(event)},
        fn {count, step, pause_ms, ratio, events} ->
          vehicles = ids(count)
          {core, actions} = Core.new(vehicles, plan(step, pause_ms: pause_ms, halt_ratio: ratio))
          sound!(core, begun(actions), vehicles, step)

          {core, all} =
            Enum.reduce(events, {core, begun(actions)}, fn event, {core, all} ->
              {next, actions} = handle(core, event)
              if core.state != :running and event != :continue, do: [] = begun(actions)
              if core.state == :stopped, do: :stopped = next.state
              if core.state == :stopped, do: [] = begun(actions)
              all = all ++ begun(actions)
              sound!(next, all, vehicles, step)
              {next, all}
            end)

          finish(core, all, vehicles, step)
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  defp handle(core, {:ended, n, ok?}), do: Core.ended(core, "V-#{n}", if(ok?, do: @ok, else: @failed))
  defp handle(core, {:paused, n}), do: Core.waited(core, n)
  defp handle(core, :interrupted), do: {Core.interrupted(core), []}
  defp handle(core, change), do: apply(Core, change, [core])

  defp sound!(core, begun, vehicles, step) do
    true = begun == Enum.uniq(begun)
    true = MapSet.size(core.under_way) <= step

    true =
      Enum.sort(core.waiting ++ MapSet.to_list(core.under_way) ++ Map.keys(core.results)) ==
        Enum.sort(vehicles)

    true = Enum.sort(begun) == Enum.sort(MapSet.to_list(core.under_way) ++ Map.keys(core.results))
  end

  # Everything that begins has its end, and every pause: then it is over.
  defp finish(core, begun, vehicles, step) do
    sound!(core, begun, vehicles, step)

    cond do
      Core.over?(core) ->
        case core.state do
          :done -> core.waiting == []
          :halted -> core.waiting != [] and Core.failing?(core)
          _stopped_or_interrupted -> true
        end

      MapSet.size(core.under_way) > 0 ->
        {core, actions} = Core.ended(core, Enum.at(core.under_way, 0), @ok)
        finish(core, begun ++ begun(actions), vehicles, step)

      core.state == :paused ->
        {core, actions} = Core.continue(core)
        finish(core, begun ++ begun(actions), vehicles, step)

      true ->
        {core, actions} = Core.waited(core, core.steps)
        finish(core, begun ++ begun(actions), vehicles, step)
    end
  end
end
