defmodule Aerie.Base.Names.SuccessorTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Names
  alias Aerie.Base.Names.Successor

  # A supervisor with one named child that ends only when it is told to.
  defmodule Slow do
    use GenServer

    def start_link({gateway, test}),
      do: GenServer.start_link(__MODULE__, test, name: Names.via(gateway, :slow))

    @impl GenServer
    def init(test) do
      Process.flag(:trap_exit, true)
      send(test, {:started, self()})
      {:ok, test}
    end

    @impl GenServer
    def handle_info(:end, _test), do: {:noreply, nil}

    @impl GenServer
    def terminate(_reason, nil), do: :ok

    def terminate(_reason, test) do
      send(test, {:ending, self()})
      receive(do: (:end -> :ok))
    end
  end

  defp tree(gateway) do
    %{
      id: :tree,
      type: :supervisor,
      start: {Supervisor, :start_link, [[{Slow, {gateway, self()}}], [strategy: :one_for_one]]}
    }
  end

  @tag :capture_log
  test "a restart waits for the child of the predecessor, and counts once" do
    {:ok, top} =
      Supervisor.start_link([Successor.child_spec(tree(make_ref()))], strategy: :one_for_one, max_restarts: 1)

    assert_receive {:started, child}
    [{:tree, killed, :supervisor, _modules}] = Supervisor.which_children(top)
    Process.exit(killed, :kill)
    assert_receive {:ending, ^child}
    send(child, :end)
    assert_receive {:started, next}
    assert next != child and Process.alive?(top)
    send(next, :end)
  end

  @tag :capture_log
  test "a predecessor that does not end is killed" do
    {:ok, top} = Supervisor.start_link([Successor.child_spec(tree(make_ref()))], strategy: :one_for_one)
    assert_receive {:started, child}
    monitor = Process.monitor(child)
    [{:tree, killed, :supervisor, _modules}] = Supervisor.which_children(top)
    Process.exit(killed, :kill)
    assert_receive {:DOWN, ^monitor, :process, ^child, :killed}
    assert_receive {:started, next}
    send(next, :end)
  end

  @tag :capture_log
  test "a process whose supervisors are alive keeps its name" do
    gateway = make_ref()
    start_supervised!(tree(gateway))
    assert_receive {:started, child}
    %{start: {module, function, arguments}} = Successor.child_spec({Slow, {gateway, self()}})
    assert {:error, {:already_started, ^child}} = apply(module, function, arguments)
    send(child, :end)
  end
end
