defmodule Aerie.Processes do
  @moduledoc """
  The processes of a gateway: its supervision tree with the restarts (`Aerie.Processes.Restarts`), counted whether or
  not somebody is looking, and the busiest ones.

  The counter monitors the processes that it knows. It does not know those that started after its last look at the tree,
  so it looks again shortly after a death, and every minute.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Processes.{Busiest, Restarts, Tree}

  @after_death_ms 500
  @idle_ms 60_000
  @call_ms 10_000

  @doc "Options: `:gateway`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :process_restarts))

  @doc "The present tree, each process with its restarts; a gateway whose processes are not counted has none."
  @spec tree(Names.gateway()) :: [{Tree.tree_node(), Restarts.count() | nil}]
  def tree(gateway) do
    GenServer.call(Names.via(gateway, :process_restarts), :tree, @call_ms)
  catch
    :exit, _absent_or_busy -> for node <- Tree.of(gateway), do: {node, nil}
  end

  @doc "The busiest processes of the virtual machine, of so many milliseconds."
  @spec busiest(pos_integer()) :: [Busiest.row()]
  defdelegate busiest(ms), to: Busiest, as: :of

  @impl GenServer
  def init(options) do
    Process.set_label({:process_restarts, options[:gateway]})
    {:ok, %{gateway: options[:gateway], restarts: Restarts.new(), timer: nil}, {:continue, :look}}
  end

  @impl GenServer
  def handle_continue(:look, state), do: {:noreply, state |> look() |> elem(1)}

  @impl GenServer
  def handle_call(:tree, _from, state) do
    {tree, state} = look(state)
    {:reply, for(node <- tree, do: {node, Restarts.of(state.restarts, node.path)}), state}
  end

  @impl GenServer
  def handle_info({:DOWN, ref, :process, _pid, reason}, state) do
    restarts = Restarts.down(state.restarts, ref, reason, System.os_time(:microsecond))
    {:noreply, look_in(%{state | restarts: restarts}, @after_death_ms)}
  end

  def handle_info(:look, state), do: {:noreply, state |> look() |> elem(1)}
  def handle_info(_stray, state), do: {:noreply, state}

  defp look(state) do
    tree = Tree.of(state.gateway)
    processes = for %{path: path, pid: pid} when pid != nil <- tree, do: {path, pid}
    restarts = Restarts.seen(state.restarts, processes, System.os_time(:microsecond))
    {tree, look_in(%{state | restarts: restarts}, @idle_ms)}
  end

  # The deaths of a whole subtree are one look, which another death does not put off.
  defp look_in(%{timer: {timer, @after_death_ms}} = state, @after_death_ms) do
    if Process.read_timer(timer), do: state, else: look_in(%{state | timer: nil}, @after_death_ms)
  end

  defp look_in(state, ms) do
    _ = with {timer, _ms} <- state.timer, do: Process.cancel_timer(timer)
    %{state | timer: {Process.send_after(self(), :look, ms), ms}}
  end
end
