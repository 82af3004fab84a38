defmodule Aerie.Fleet.Operations.SequencePropertyTest do
  @moduledoc """
  A take-off in which anything happens in any order: the real core, the real steps and waits, and vehicles that are
  armed, climb, refuse, answer too late and disarm by themselves.
  """
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.{Core, Sequence}
  alias Aerie.Fleet.Operations.Sequence.Wait
  alias Aerie.Vehicle.Snapshot

  @failed %{verdict: :failed, status: "timeout", reason: "no"}
  @ok %{verdict: :ok, status: "completed", reason: nil}

  defp event do
    :proper_types.frequency([
      # The next step of what is under way, and how the vehicle takes it.
      {20, {:step, :proper_types.oneof([:does, :does, :does, :refuses, :does_unheard])}},
      {4, {:gives_up, :proper_types.boolean()}},
      {8, {:climbs, :proper_types.integer(1, 8)}},
      {4, {:disarms, :proper_types.integer(1, 8)}},
      {3, {:waited, :proper_types.integer(1, 9)}},
      {4, :continue},
      {2, :proper_types.oneof([:pause, :interrupted])},
      {1, :proper_types.oneof([:stop, :abort])}
    ])
  end

  test "never two stand armed on the ground, each begins once, nothing begins after a stop, and it ends" do
    property =
      :proper.forall(
        {:proper_types.integer(1, 8), :proper_types.oneof([0, 700]), :proper_types.oneof([0.0, 0.5, 1.0]),
         :proper_types.resize(80, :proper_types.list(event()))},
        fn {count, pause_ms, ratio, events} ->
          world = events |> Enum.reduce(start(count, pause_ms, ratio), &happen/2) |> finish(1_000)
          Core.over?(world.core)
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 1_000]) == true, inspect(:proper.counterexample())
  end

  defp start(count, pause_ms, ratio) do
    ids = for n <- 1..count, do: "V-#{n}"
    {core, actions} = Core.new(ids, %{step: 1, pause_ms: pause_ms, halt_ratio: ratio})
    sky = Map.new(ids, &{&1, %{armed: false, height: 0}})
    act(%{core: core, sky: sky, work: %{}, begun: []}, {core, actions})
  end

  # --- The operation, as its server runs it

  defp act(world, {core, actions}) do
    began = for {:begin, id} <- actions, do: id
    if world.core.state == :stopped, do: [] = began
    [] = began -- (began -- world.begun)
    work = for {:cancel, id} <- actions, reduce: world.work, do: (work -> Map.delete(work, id))
    work = Enum.reduce(began, work, &Map.put(&2, &1, steps(&1)))
    sound!(%{world | core: core, work: work, begun: world.begun ++ began})
  end

  defp sound!(world) do
    on_ground = for {id, %{armed: true, height: 0}} <- world.sky, do: id
    true = length(on_ground) <= 1
    true = Enum.sort(Map.keys(world.work)) == Enum.sort(MapSet.to_list(world.core.under_way))
    world
  end

  defp steps(id) do
    given = [Sequence.take_off(snapshot(id, %{armed: false, height: 0}), 10, 5)]
    {:ok, [%{steps: steps}]} = Sequence.parse(given, 1, 0)
    Sequence.guarded(steps)
  end

  defp happen({:step, how}, world) do
    case Map.to_list(world.work) do
      [] -> world
      [{id, [step | rest]}] -> step(step, how, id, rest, world)
    end
  end

  # A wait that took too long, or a task that died.
  defp happen({:gives_up, known?}, world) do
    for {id, _steps} <- world.work, reduce: world do
      world -> ended(world, id, if(known?, do: @failed, else: %{@failed | status: "unknown"}))
    end
  end

  defp happen({:climbs, n}, world) do
    case world.sky["V-#{n}"] do
      %{armed: true, height: height} when height > 0 ->
        put_in(world.sky["V-#{n}"].height, min(height + 3, 10))

      _other ->
        world
    end
  end

  # On the ground by itself, in the air after it has landed.
  defp happen({:disarms, n}, world) do
    if is_map_key(world.sky, "V-#{n}"),
      do: put_in(world.sky["V-#{n}"], %{armed: false, height: 0}),
      else: world
  end

  defp happen({:waited, n}, world), do: act(world, Core.waited(world.core, n))
  defp happen(:interrupted, world), do: act(%{world | work: %{}}, {Core.interrupted(world.core), []})
  defp happen(change, world), do: act(world, apply(Core, change, [world.core]))

  # --- The vehicles

  defp step({:wait, wait}, _how, id, rest, world) do
    others = for {other, state} <- world.sky, other != id, do: snapshot(other, state)

    case Wait.look(wait, snapshot(id, world.sky[id]), others) do
      :ok -> went(world, id, rest)
      {:waiting, _why, whom} when is_map_key(world.sky, whom) -> world
    end
  end

  defp step(_command, :refuses, id, _rest, world), do: ended(world, id, @failed)

  defp step({:command, type, _params}, how, id, rest, world) do
    world = sound!(update_in(world.sky[id], &obey(type, &1)))
    if how == :does, do: went(world, id, rest), else: ended(world, id, @failed)
  end

  defp obey("arm", state), do: %{state | armed: true}
  defp obey("takeoff", %{armed: true} = state), do: %{state | height: 1}
  defp obey(_other, state), do: state

  defp went(world, id, []), do: ended(world, id, @ok)
  defp went(world, id, rest), do: put_in(world.work[id], rest)

  defp ended(world, id, result),
    do: act(%{world | work: Map.delete(world.work, id)}, Core.ended(world.core, id, result))

  defp snapshot(id, %{armed: armed, height: height}) do
    at = %{at: 0}

    groups = %{
      mode: Map.put(at, :data, %{armed: armed, in_air: height > 0, mode: "GUIDED"}),
      position: Map.put(at, :data, %{alt_rel: height, lat: 47.0, lon: 8.0})
    }

    %Snapshot{id: id, autopilot: :ardupilot, vehicle_type: :copter, groups: groups}
  end

  # Every vehicle does what it is told, and nobody stops it: then it ends.
  defp finish(world, left) when left > 0 do
    cond do
      Core.over?(world.core) and world.core.state in [:done, :stopped] -> world
      world.core.state in [:paused, :halted, :interrupted] -> finish(happen(:continue, world), left - 1)
      world.work == %{} -> finish(happen({:waited, world.core.steps}, world), left - 1)
      true -> world |> fly() |> go_on() |> finish(left - 1)
    end
  end

  # A wait ends: what it waits for comes, or its time is over.
  defp go_on(world) do
    case happen({:step, :does}, world) do
      ^world -> if fly(world) == world, do: happen({:gives_up, true}, world), else: world
      next -> next
    end
  end

  # Those in the air climb, and the one that stands armed and is not under way disarms.
  defp fly(world) do
    for {id, state} <- world.sky, "V-" <> n = id, reduce: world do
      world when state.armed and state.height == 0 and not is_map_key(world.work, id) ->
        happen({:disarms, n}, world)

      world ->
        happen({:climbs, n}, world)
    end
  end
end
