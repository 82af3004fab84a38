defmodule Aerie.Base.NamesTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Base.Names

  # A process with a role, that runs what it is sent.
  defp part(gateway, role, id \\ nil) do
    {:ok, pid} = Agent.start(fn -> nil end, name: Names.via(gateway, role, id))
    on_exit(fn -> if Process.alive?(pid), do: Agent.stop(pid) end)
    pid
  end

  defp in_process(pid, fun), do: Agent.get(pid, fn _state -> fun.() end, Aerie.Patience.ms())

  test "a role has one process in a gateway, and one for each id" do
    {one, other} = {make_ref(), make_ref()}
    pid = part(one, :session, {"main", 1})
    assert Names.whereis(one, :session, {"main", 1}) == pid
    assert Names.whereis(one, :session, {"main", 2}) == nil
    assert Names.whereis(other, :session, {"main", 1}) == nil

    assert {:error, {:already_started, ^pid}} =
             Agent.start(fn -> nil end, name: Names.via(one, :session, {"main", 1}))

    second = part(one, :session, {"main", 2})
    assert Enum.sort(Names.processes(one, :session)) == Enum.sort([pid, second])
    assert Names.roles(one, pid) == [session: {"main", 1}]
    assert in_process(pid, fn -> Names.register(one, :clients, "ws") end) == :ok
    assert Names.register(one, :clients, "ws") == {:error, :taken}
  end

  test "a value is read without a call, while its owner lives" do
    gateway = make_ref()
    pid = part(gateway, :ledger)
    assert Names.value(gateway, :ledger) == nil
    before = Names.epoch()
    :ok = in_process(pid, fn -> Names.put_value(gateway, :ledger, nil, :failing) end)
    assert Names.epoch() > before
    assert Names.value(gateway, :ledger) == :failing
    assert [{nil, ^pid, :failing}] = Names.all(gateway, :ledger)
    Agent.stop(pid)
    assert Names.value(gateway, :ledger) == nil
  end

  test "a table is read while its owner lives; an error of the reader is the reader's" do
    gateway = make_ref()
    pid = part(gateway, :tickets)
    read = fn -> Names.read(gateway, :tickets, :absent, &:ets.lookup_element(&1, :a, 2)) end
    assert read.() == :absent

    :ok =
      in_process(pid, fn ->
        table = :ets.new(:tickets, [:public])
        :ets.insert(table, {:a, 1})
        Names.put_value(gateway, :tickets, table)
      end)

    assert read.() == 1

    assert_raise ArgumentError, fn ->
      Names.read(gateway, :tickets, :absent, &:ets.lookup_element(&1, :b, 2))
    end

    Agent.stop(pid)
    assert read.() == :absent
  end

  test "a held value is its owner's: it goes with it, and the next owner's takes its place" do
    gateway = make_ref()
    hold = fn pid, value -> in_process(pid, fn -> Names.put_held(gateway, :store, value) end) end
    assert Names.held(gateway, :store) == nil
    one = part(gateway, :store)
    hold.(one, %{n: 1})
    assert Names.held(gateway, :store) == %{n: 1}
    Agent.stop(one)
    assert Names.held(gateway, :store) == nil
    eventually(fn -> :persistent_term.get({Names, gateway, :store}, nil) == nil end)
    two = part(gateway, :store)
    hold.(two, %{n: 2})
    assert Names.held(gateway, :store) == %{n: 2}
    # What the cleaner does late about the first one does not touch the second.
    :ok = Names.forget(one)
    assert Names.held(gateway, :store) == %{n: 2}
  end

  test "owners that follow each other at once never lose their value" do
    gateway = make_ref()

    for n <- 1..200 do
      {:ok, pid} = Agent.start(fn -> nil end, name: Names.via(gateway, :router))
      in_process(pid, fn -> Names.put_held(gateway, :router, n) end)
      assert Names.held(gateway, :router) == n
      Process.exit(pid, :kill)
      eventually(fn -> Names.whereis(gateway, :router) == nil end)
    end
  end
end
