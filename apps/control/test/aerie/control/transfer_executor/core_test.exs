defmodule Aerie.Control.TransferExecutor.CoreTest do
  @moduledoc "Which transfer of a vehicle is under way; the machines are toys."
  use ExUnit.Case, async: true

  alias Aerie.Control.TransferExecutor.{Core, Job}
  alias MavCodec.Messages, as: M

  # Sends when it starts, ends with what it hears, is silent for a second.
  defmodule Toy do
    defstruct [:name, :due, :seq, :heard?, at: []]
    def wake_at(toy), do: toy.due
    def seq(toy), do: toy.seq + 1
    def heard?(toy), do: toy.heard?

    def handle(toy, {:start, now}),
      do: {%{toy | due: now + 1_000_000}, [{:send, [toy.name]}, {:progress, 0, 2}]}

    def handle(toy, {:cancel, _now}), do: {toy, [{:done, {:error, :cancelled}}]}
    def handle(toy, {:rebooted, _now}), do: {toy, [{:done, {:error, :rebooted}}]}
    def handle(toy, {:tick, _now}), do: {toy, [{:done, {:error, :no_answer}}]}

    def handle(toy, {:message, _message, _source, _now}),
      do: {toy, [{:data, 0, "x"}, {:done, {:ok, toy.name}}]}
  end

  @facts %{target: {1, 1}, version: 2, links: ["link-1"]}

  defp job(id, lanes, more \\ []) do
    start = fn context -> {:ok, %Toy{name: id, seq: context.seq}} end
    struct!(%Job{id: id, lanes: lanes, start: start, until: 100_000_000}, more)
  end

  defp core do
    {core, []} = Core.handle(Core.new(), {:vehicle, @facts})
    core
  end

  defp run(core, events),
    do: Enum.flat_map_reduce(events, core, fn event, core -> swap(Core.handle(core, event)) end)

  defp swap({core, actions}), do: {actions, core}

  test "of a lane one is under way, the next ones follow in order; other lanes do not wait" do
    {actions, core} =
      run(core(), [
        {:submit, job("a", [:params]), 0},
        {:submit, job("b", [:params]), 0},
        {:submit, job("c", [:log]), 0},
        {:turn, :log, 0},
        {:submit, job("d", [:params]), 0}
      ])

    assert for({:send, [id]} <- actions, do: id) == ["a", "c"]

    assert Core.listens(core) |> Enum.sort() ==
             Enum.sort([22, 322, 324, M.ParamError.id(), M.ComponentMetadata.id(), 118, 120])

    {actions, core} = run(core, [{:message, 22, :value, {1, 1}, 10}])

    assert [{:data, "a", 0, "x"}, {:done, "a", {:ok, "a"}}, {:send, ["b"]}, {:progress, "b", {0, 2}}] =
             actions

    # Silence is told to the one that waits for an answer.
    assert Core.wake_at(core) == 1_000_000
    {actions, _core} = run(core, [{:tick, 1_000_010}])
    assert {:done, "b", {:error, :no_answer}} in actions
    assert {:send, ["d"]} in actions
  end

  test "one that needs two lanes is not overtaken for ever, and overtakes nobody" do
    {actions, core} =
      run(core(), [
        {:submit, job("a", [:params]), 0},
        {:submit, job("both", [:params, :file]), 0},
        {:submit, job("f", [:file]), 0}
      ])

    assert actions == [{:send, ["a"]}, {:progress, "a", {0, 2}}]
    {actions, core} = run(core, [{:cancel, "a", 1}])
    assert {:take, :file} in actions
    {actions, core} = run(core, [{:turn, :file, 2}])
    assert {:send, ["both"]} in actions
    {actions, core} = run(core, [{:message, 110, :packet, {1, 1}, 3}])
    assert [{:data, _, _, _}, {:give_back, :file}, {:done, "both", {:ok, "both"}}, {:take, :file}] = actions
    # The numbers of FTP go on.
    {_actions, core} = run(core, [{:turn, :file, 4}])
    assert core.jobs["f"].machine.seq == 1
  end

  test "a ground station's turn is waited for, told, and not longer than a minute" do
    {actions, core} = run(core(), [{:submit, job("m", [:mission]), 0}, {:held, :mission, {255, 190}}])
    assert actions == [{:take, :mission}, {:progress, "m", {:waiting, {255, 190}}}]
    assert Core.listens(core) == []
    assert Core.wake_at(core) == 60_000_000
    {actions, core} = run(core, [{:tick, 60_000_000}])
    assert actions == [{:give_back, :mission}, {:done, "m", {:error, :waited}}]
    # It comes too late.
    assert {[{:give_back, :mission}], _core} = run(core, [{:turn, :mission, 60_000_001}])
    # Its own deadline may be earlier.
    {_actions, core} = run(core, [{:submit, job("n", [:mission], until: 5), 0}])
    assert Core.wake_at(core) == 5
  end

  test "equal readings are one, an id is used once, and the queue has an end" do
    {actions, core} =
      run(core(), [
        {:submit, job("a", [:params], share: :list), 0},
        {:submit, job("b", [:params], share: :list), 0},
        {:submit, job("a", [:params]), 0}
      ])

    assert [{:joined, "b", "a"}, {:done, "a", {:error, :taken}}] = Enum.drop(actions, 2)
    {_actions, core} = run(core, for(n <- 2..32, do: {:submit, job("j#{n}", [:params]), 0}))
    assert Core.size(core) == 32
    assert {[{:done, "late", {:error, :full}}], _core} = run(core, [{:submit, job("late", [:log]), 0}])
  end

  test "a reading for a stranger makes way for anything else, under way or waiting, and for a ground station" do
    {_actions, core} =
      run(core(), [
        {:submit, job("s", [:mission], yields: true), 0},
        {:turn, :mission, 0},
        {:submit, job("t", [:mission], yields: true), 0},
        {:submit, job("p", [:params], yields: true), 0}
      ])

    assert {[{:give_back, :mission}, {:done, "s", yielded}, {:done, "t", yielded}, {:take, :mission}], core} =
             run(core, [{:submit, job("upload", [:mission]), 1}])

    assert yielded == {:error, :yielded}
    # The vehicle learns it from the machine, which is not asked again.
    assert {actions, core} = run(core, [{:turn, :mission, 2}, {:wanted, :mission, 3}])
    assert {:send, ["upload"]} in actions and Core.known?(core, "upload") and Core.known?(core, "p")

    {_actions, core} =
      run(core(), [{:submit, job("s", [:file], yields: true), 0}, {:turn, :file, 0}])

    assert {[{:give_back, :file}, {:done, "s", {:error, :yielded}}], _core} = run(core, [{:wanted, :file, 1}])
  end

  test "a caller that joins such a reading keeps it from making way, and a full queue makes room by it" do
    {_actions, core} =
      run(core(), [
        {:submit, job("s", [:params], yields: true, share: :list), 0},
        {:submit, job("t", [:params], yields: true, share: :list), 0}
      ])

    full = for(n <- 2..32, do: {:submit, job("j#{n}", [:log], yields: true), 0})
    {_actions, crowded} = run(core, full)
    assert {actions, crowded} = run(crowded, [{:submit, job("late", [:params]), 0}])
    assert {:done, "s", {:error, :yielded}} in actions and Core.known?(crowded, "late")

    {_actions, core} = run(core, [{:submit, job("mine", [:params], share: :list), 0}])
    assert {[], core} = run(core, [{:submit, job("set", [:params]), 0}])
    assert Core.known?(core, "s") and Core.known?(core, "set")
  end

  test "a reboot reaches what is under way; what waits begins after it" do
    {_actions, core} = run(core(), [{:submit, job("a", [:params]), 0}, {:submit, job("b", [:params]), 0}])
    {actions, _core} = run(core, [{:rebooted, 5}])
    assert [{:done, "a", {:error, :rebooted}}, {:send, ["b"]}, _progress] = actions
  end

  test "that FTP is not answered is remembered for the links by which it was asked" do
    job = fn id, heard? ->
      start = fn context -> {:ok, %Toy{name: context.ftp?, seq: context.seq, heard?: heard?}} end
      %Job{id: id, lanes: [:file], start: start, until: 100_000_000}
    end

    trial = fn core, heard? ->
      {actions, core} = run(core, [{:submit, job.("a", heard?), 0}, {:turn, :file, 0}, {:cancel, "a", 1}])
      [asked?] = for {:send, [asked?]} <- actions, do: asked?
      {asked?, core}
    end

    {true, core} = trial.(core(), false)
    assert {false, core} = trial.(core, nil)
    # By another link it may be; after a reboot, too.
    assert {true, _core} = trial.(elem(Core.handle(core, {:vehicle, %{@facts | links: ["link-2"]}}), 0), nil)
    assert {true, _core} = trial.(elem(Core.handle(core, {:rebooted, 2}), 0), nil)
    {false, core} = trial.(core, true)
    assert {true, _core} = trial.(core, nil)
  end

  test "what cannot be made a machine ends at once" do
    refused = job("a", [:file], start: fn _context -> {:error, "too much"} end)
    {actions, core} = run(core(), [{:submit, refused, 0}, {:turn, :file, 1}])
    assert [{:take, :file}, {:give_back, :file}, {:done, "a", {:error, "too much"}}] = actions
    assert Core.size(core) == 0
  end

  test "whatever comes: lanes have one at a time, each submitted has one end, turns are given back" do
    id = :proper_types.oneof(for(n <- 1..9, do: "#{n}"))
    lanes = :proper_types.oneof([[:params], [:params, :file], [:file], [:mission], [:log]])
    kind = :proper_types.oneof([:mission, :file])
    message = :proper_types.oneof([22, 110, 47, 120])

    event =
      :proper_types.oneof([
        {:submit, id, lanes},
        {:submit, id, lanes},
        {:yields, id, lanes},
        {:wanted, kind},
        {:cancel, id},
        {:turn, kind},
        {:turn, kind},
        {:message, message},
        :tick,
        :rebooted
      ])

    property =
      :proper.forall(:proper_types.list({event, :proper_types.range(0, 2_000_000)}), fn events ->
        {core, now, log} = Enum.reduce(events, {core(), 0, []}, &step/2)
        # Left alone, everything ends.
        {core, _now, log} =
          Enum.reduce(1..100, {core, now, log}, fn _n, acc -> step({:tick, 1_000_000}, acc) end)

        count = fn what -> Enum.count(log, &(&1 == what)) end
        began = for {:began, _id} <- log, do: 1
        ended = for {:done, _id, result} <- log, result != {:error, :taken}, do: 1

        Core.size(core) == 0 and length(began) == length(ended) and
          Enum.all?([:mission, :file], &(count.({:take, &1}) <= count.({:give_back, &1})))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  defp step({event, dt}, {core, now, log}) do
    now = now + dt

    {event, began} =
      case event do
        {:submit, id, _lanes} when is_map_key(core.jobs, id) -> {{:submit, job(id, [:log]), now}, []}
        {:yields, id, _lanes} when is_map_key(core.jobs, id) -> {{:cancel, id, now}, []}
        {:yields, id, lanes} -> {{:submit, job(id, lanes, yields: true), now}, [{:began, id}]}
        {:submit, id, lanes} -> {{:submit, job(id, lanes), now}, [{:began, id}]}
        {:message, id} -> {{:message, id, :said, {1, 1}, now}, []}
        {what, of} -> {{what, of, now}, []}
        what -> {{what, now}, []}
      end

    {core, actions} = Core.handle(core, event)
    lanes = for {_id, %{phase: phase} = job} <- core.jobs, phase != :queued, lane <- job.lanes, do: lane
    true = lanes == Enum.uniq(lanes)
    true = core.order == Enum.uniq(core.order)
    {core, now, log ++ began ++ actions}
  end
end
