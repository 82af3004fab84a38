defmodule Aerie.Base.Names.BookTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 2]

  alias Aerie.Base.Names
  alias Aerie.Base.Names.{Book, Cleaner}

  defp other(fun) do
    test = self()

    pid =
      spawn(fn ->
        send(test, {:said, self(), fun.()})
        receive(do: (:end -> :ok))
      end)

    assert_receive {:said, ^pid, answer}
    {pid, answer}
  end

  defp kill(pid) do
    monitor = Process.monitor(pid)
    Process.exit(pid, :kill)
    assert_receive {:DOWN, ^monitor, :process, ^pid, _reason}
  end

  test "a key has one owner, whose death frees it at once" do
    key = {make_ref(), :role, nil}
    {pid, :ok} = other(fn -> Book.register(key, 1) end)
    assert Book.register(key, 2) == {:error, {:already_registered, pid}}
    assert Book.lookup(key) == {pid, 1}
    kill(pid)
    assert Book.lookup(key) == nil
    assert Book.register(key, 2) == :ok
    assert Book.register(key, 2) == {:error, {:already_registered, self()}}
    assert Book.lookup(key) == {self(), 2}
    assert Book.unregister(key) == :ok
    assert Book.lookup(key) == nil
  end

  test "only its owner gives a key a value, or gives it up" do
    key = {make_ref(), :role, nil}
    {pid, :ok} = other(fn -> Book.register(key, 1) end)
    assert_raise MatchError, fn -> Book.put_value(key, 2) end
    assert Book.unregister(key) == :ok
    assert Book.lookup(key) == {pid, 1}
  end

  test "keys that look like patterns are keys" do
    for id <- [:_, :"$1", %{a: 1}, {:const, 1}] do
      gateway = {id, make_ref()}
      assert Names.register(gateway, :role, id) == :ok
      assert Names.register(gateway, :role, nil) == :ok
      assert [{^id, _, nil}] = for({^id, _, _} = row <- Names.all(gateway, :role), do: row)
      assert Book.unregister({gateway, :role, id}) == :ok
      assert Names.roles(gateway, self()) == [{:role, nil}]
    end
  end

  test "a topic has many members" do
    topic = make_ref()
    {pid, :ok} = other(fn -> Book.join(topic, :b) end)
    assert Book.join(topic, :a) == :ok
    assert Enum.sort(Book.members(topic)) == Enum.sort([{self(), :a}, {pid, :b}])
    assert Book.leave(topic) == :ok
    assert Book.members(topic) == [{pid, :b}]
    kill(pid)
    eventually(fn -> Book.members(topic) == [] end, "the dead member is removed")
  end

  test "names outlive the cleaner, and one that restarts removes what ended meanwhile" do
    key = {make_ref(), :role, nil}
    {pid, :ok} = other(fn -> Book.register(key, 1) end)
    :ok = Book.register({key, self()}, 1)
    :ok = :sys.suspend(Cleaner)
    kill(pid)
    kill(Process.whereis(Cleaner))
    eventually(fn -> pid not in Book.owners() end, "the next one removed it")
    assert Book.lookup({key, self()}) == {self(), 1}
  end

  test "a server has its name while it lives" do
    name = Names.via(make_ref(), :agent)
    {:ok, agent} = Agent.start_link(fn -> 1 end, name: name)
    assert {:error, {:already_started, ^agent}} = Agent.start_link(fn -> 2 end, name: name)
    assert Agent.get(name, & &1) == 1
    :ok = Agent.stop(name)
    assert {:noproc, _call} = catch_exit(Agent.get(name, & &1))
  end
end
