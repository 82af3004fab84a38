defmodule Aerie.Fleet.Bridge.Connection.MachineTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Connection.Machine

  defp run(machine, events) do
    Enum.map_reduce(events, machine, fn event, machine ->
      {machine, actions} = Machine.handle(machine, event)
      {actions, machine}
    end)
  end

  defp timers(actions), do: for({:timer, ms} <- List.flatten(actions), do: ms)

  test "the first retry comes at once, then pauses grow to the limit" do
    failures = List.duplicate([{:failed, "no"}, :retry], 12) |> List.flatten()
    {actions, _} = run(Machine.new(250, 30_000), [{:urls, ["nats://a"]} | failures])
    [first, second | _] = pauses = timers(actions)
    assert first == 0
    assert second in 250..500
    assert List.last(pauses) in 15_000..30_000
  end

  test "each attempt takes the next URL" do
    events = [{:urls, ["nats://a", "nats://b"]}, {:failed, "no"}, :retry, {:failed, "no"}, :retry]
    {actions, _} = run(Machine.new(1, 2), events)
    assert for({:connect, url} <- List.flatten(actions), do: url) == ["nats://a", "nats://b", "nats://a"]
  end

  test "a good connection that is lost is tried again at once; one that never lasts is not a busy loop" do
    up = [{:urls, ["nats://a"]}, :connected]
    {actions, _} = run(Machine.new(250, 30_000), up ++ [{:closed, "x", 60_000}])
    assert timers(actions) == [0]

    flapping = List.flatten(List.duplicate([{:closed, "x", 10}, :retry, :connected], 8))
    {actions, _} = run(Machine.new(250, 30_000), up ++ flapping)
    assert [0, second | _] = pauses = timers(actions)
    assert second >= 250
    assert List.last(pauses) > 5_000
  end

  test "the message that the embedded server is up ends the waiting" do
    events = [{:urls, ["nats://a"]}, {:failed, "no"}, :retry, {:failed, "no"}, {:urls, ["nats://a"]}]
    {actions, machine} = run(Machine.new(250, 30_000), events)
    assert [:cancel_timer, {:connect, "nats://a"}] = List.last(actions)
    assert machine.phase == :connecting
  end

  test "the same reason is logged once" do
    events = [{:urls, ["nats://a"]}, {:failed, "no"}, :retry, {:failed, "no"}, :retry, {:failed, "other"}]
    {actions, _} = run(Machine.new(1, 2), events)
    assert length(for {:log, :warning, _} <- List.flatten(actions), do: 1) == 2
  end

  test "why there is no connection: of each server the last reason, logged once although they take turns" do
    urls = ["nats://a", "nats://b"]
    events = [{:urls, urls}, {:failed, "no"}, :retry, {:failed, "refused"}, :retry, {:failed, "no"}]
    {actions, machine} = run(Machine.new(1, 2), events)
    assert length(for {:log, :warning, _} <- List.flatten(actions), do: 1) == 2

    assert Machine.problem(machine) ==
             "cannot connect to NATS at nats://a: no; cannot connect to NATS at nats://b: refused"

    {_, machine} = run(machine, [:retry, :connected])
    assert Machine.problem(machine) == nil
    {_, machine} = run(machine, [{:closed, "revoked", 10}])
    assert Machine.problem(machine) == "the connection to NATS at nats://b is lost: revoked"
    # The embedded server has another port after a restart.
    {_, machine} = run(machine, [{:urls, ["nats://c"]}])
    assert Machine.problem(machine) == nil
  end

  test "without a server nothing is tried, and late events change nothing" do
    machine = Machine.new(1, 2)

    for event <- [{:urls, []}, :retry, :connected, {:failed, "x"}, {:closed, "x", 1}],
        do: assert({_, []} = Machine.handle(machine, event))
  end

  # At most one of: an attempt that runs, a timer that runs, a connection. Else it would connect twice.
  test "any events: never two attempts at once" do
    event =
      :proper_types.oneof([
        {:urls, :proper_types.list(:proper_types.oneof(["nats://a", "nats://b"]))},
        :connected,
        {:failed, "x"},
        {:closed, "x", :proper_types.integer(0, 10_000)},
        :retry
      ])

    property =
      :proper.forall(:proper_types.list(event), fn events ->
        events
        |> Enum.reduce({Machine.new(10, 100), true}, fn event, {machine, fine} ->
          {next, actions} = Machine.handle(machine, event)
          connects = Enum.count(actions, &match?({:connect, _}, &1))
          allowed = if machine.phase in [:idle, :waiting], do: 1, else: 0
          timer = Enum.count(actions, &match?({:timer, _}, &1))
          {next, fine and connects <= allowed and timer <= 1 and (timer == 0 or next.phase == :waiting)}
        end)
        |> elem(1)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
