defmodule Aerie.Control.Ledger.CoreTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Ledger.Core

  @now 1_795_339_800_000_000
  @minute 60_000_000

  defp command(id, type \\ "arm"), do: command(id, type, @now)

  defp command(id, type, now) do
    {:ok, command} = Command.new([id: id, vehicle: "VID-001", type: type], now)
    command
  end

  # The answer and the state, with its records as a file would give them back.
  defp step({answer, records, core}, file), do: {answer, core, file ++ plain(records)}
  defp plain(records), do: records |> JSON.encode!() |> JSON.decode!()

  defp reborn(file, core),
    do: Enum.reduce(file, Core.new(core.max_entries, div(core.max_age_us, 1_000_000)), &Core.replay(&2, &1))

  test "the same id and digest gives the stored result, another digest is refused" do
    core = Core.new(10, 3600)
    {:new, core, file} = core |> Core.admit(command("a"), @now) |> step([])
    {:in_flight, core, file} = core |> Core.admit(command("a"), @now) |> step(file)
    assert {{:deny, :id, text}, [], _core} = Core.admit(core, command("a", "disarm"), @now)
    assert text =~ "the id a was used for another command"
    {:ok, core, file} = core |> Core.sending("a", :never, @now) |> step(file)
    result = Result.new("a", :completed, nil, %{"ms" => 120})
    {:ok, core, file} = core |> Core.finish(result, @now) |> step(file)
    # A later deadline is the same command.
    later = %{command("a") | deadline: @now + @minute}

    for core <- [core, reborn(file, core)] do
      assert {{:stored, ^result}, [], _core} = Core.admit(core, later, @now)
      assert {{:deny, :id, _used}, [], _core} = Core.admit(core, command("a", "disarm"), @now)

      assert {{:deny, :ledger, "a has its result already"}, [], _core} =
               Core.finish(core, Result.new("a", :failed), @now)
    end
  end

  test "what must not be repeated is sent once; the rest again" do
    {:new, _records, core} = Core.new(10, 3600) |> Core.admit(command("a"), @now)
    {:ok, [_record], core} = Core.sending(core, "a", :never, @now)

    assert {{:deny, :ledger, "a was sent already and must not be sent twice"}, [], _core} =
             Core.sending(core, "a", :never, @now)

    assert {:ok, [], _core} = Core.sending(core, "a", :safe, @now)
    assert {{:deny, :ledger, "b is not in the ledger"}, [], _core} = Core.sending(core, "b", :never, @now)
  end

  test "after a restart: what was not sent is forgotten, what may have been sent is unknown" do
    core = Core.new(10, 3600)
    {:new, core, file} = core |> Core.admit(command("waits"), @now) |> step([])
    {:new, core, file} = core |> Core.admit(command("sent"), @now) |> step(file)
    {:ok, core, file} = core |> Core.sending("sent", :never, @now) |> step(file)
    {commands, core, file} = file |> reborn(core) |> Core.interrupted(@now) |> step(file)
    assert [%{"id" => "sent", "type" => "arm", "vehicle" => "VID-001"}] = commands

    for core <- [core, reborn(file, core)] do
      assert {:new, _records, _core} = Core.admit(core, command("waits"), @now)
      assert {{:stored, %{status: :unknown}}, [], _core} = Core.admit(core, command("sent"), @now)
      assert {{:deny, :ledger, _text}, [], _core} = Core.sending(core, "sent", :never, @now)
      # Who looked at the vehicle knows better.
      assert {:ok, _records, core} = Core.finish(core, Result.new("sent", :completed), @now)
      assert {{:stored, %{status: :completed}}, [], _core} = Core.admit(core, command("sent"), @now)
    end
  end

  test "old ones go, but never one whose envelope could still be taken for fresh" do
    admit = fn core, id, now -> Core.admit(core, command(id, "arm", now), now) end
    {:new, _records, core} = Core.new(2, 3600) |> admit.("a", @now)
    {:new, _records, core} = admit.(core, "b", @now + @minute)
    assert {{:error, text}, [], _core} = admit.(core, "c", @now + 20 * @minute)
    assert text =~ "holds 2 commands of the last 20 minutes"
    assert {:new, [["gone", "a"] | _new], core} = admit.(core, "c", @now + 20 * @minute + 1)
    assert {:new, _records, core} = admit.(core, "d", @now + 90 * @minute)
    assert Core.count(core) == 1
  end

  test "what was denied makes room, but not if it had been sent" do
    {:new, _records, core} = Core.new(2, 3600) |> Core.admit(command("a"), @now)
    {:ok, _records, core} = Core.sending(core, "a", :never, @now)
    {:ok, file, core} = Core.finish(core, Result.new("a", :denied), @now)
    assert [["done", "a" | _rest]] = file
    {:new, _records, core} = Core.admit(core, command("b"), @now)
    assert {{:error, _full}, [], _core} = Core.admit(core, command("c"), @now)
    {:ok, _records, core} = Core.finish(core, Result.new("b", :denied), @now)

    for core <- [core, core |> Core.records() |> Enum.to_list() |> plain() |> reborn(core)] do
      assert {:new, [["gone", "b"], ["new", "c" | _more]], core} = Core.admit(core, command("c"), @now)
      assert {{:stored, %{status: :denied}}, [], _core} = Core.admit(core, command("a"), @now)
    end
  end

  test "model: whatever comes in whatever order, with kills in between, nothing is sent twice and no result is lost" do
    id = :proper_types.oneof(~w(a b c d))
    retry = :proper_types.oneof([:safe, :never])

    event =
      :proper_types.oneof([
        {:admit, id, :proper_types.oneof(["arm", "disarm"])},
        {:sending, id, retry},
        {:finish, id, :proper_types.oneof([:completed, :unknown, :denied])},
        :kill
      ])

    property =
      :proper.forall(:proper_types.list(event), fn events ->
        start = %{core: Core.new(3, 3600), file: [], now: @now, once: %{}, results: %{}, ok: true}
        Enum.reduce(events, start, &model/2).ok
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  defp model(:kill, state) do
    {_commands, core, file} =
      state.file |> reborn(state.core) |> Core.interrupted(state.now) |> step(state.file)

    # Nothing under way survives it.
    ok = Enum.all?(core.entries, fn {_id, entry} -> match?(%Result{}, entry.state) end)
    %{state | core: core, file: file, ok: state.ok and ok}
  end

  defp model({:admit, id, type}, state) do
    {answer, core, file} = state.core |> Core.admit(command(id, type), state.now) |> step(state.file)

    ok =
      case answer do
        {:stored, result} -> state.results[id] in [nil, result.status] or result.status == :unknown
        :new -> not is_map_key(state.results, id) and not is_map_key(state.once, id)
        _refused_or_in_flight -> true
      end

    %{state | core: core, file: file, now: state.now + 1, ok: state.ok and ok and Core.count(core) <= 3}
  end

  defp model({:sending, id, retry}, state) do
    {answer, core, file} = state.core |> Core.sending(id, retry, state.now) |> step(state.file)
    twice? = answer == :ok and retry == :never and is_map_key(state.once, id)
    once = if answer == :ok, do: Map.put(state.once, id, true), else: state.once
    %{state | core: core, file: file, once: once, ok: state.ok and not twice?}
  end

  defp model({:finish, id, status}, state) do
    {answer, core, file} = state.core |> Core.finish(Result.new(id, status), state.now) |> step(state.file)
    # What was denied before it was sent may make room for others.
    unsent? = not is_map_key(state.once, id) and not is_map_key(state.results, id)
    kept? = answer == :ok and not (status == :denied and unsent?)
    results = if kept?, do: Map.put(state.results, id, status), else: state.results
    %{state | core: core, file: file, results: results}
  end
end
