defmodule Aerie.Vehicle.Supervisor.TreeRestarter do
  @moduledoc """
  Restarts a vehicle's tree when it died.

  The first time at once, then with a back-off of up to 30 s (`Aerie.Base.Timing.Backoff`); a tree that lived for ten
  seconds counts as new. A tree that is to stay stopped has to be forgotten first (`forget/2`): the exit reason does not
  tell, because a supervisor that gives up exits with `:shutdown` as well.

  It also stops a lost vehicle's tree when another vehicle needs its place (`Aerie.Vehicle.Session.Capacity`).
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Timing.Backoff
  alias Aerie.Vehicle

  @min_delay_ms 250
  @max_delay_ms 30_000
  @healthy_ms 10_000

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :tree_restarter))
  end

  @doc "Watches a tree that was started with these options."
  @spec watch(pid(), Store.vehicle_key(), pid(), keyword()) :: :ok
  def watch(restarter, key, tree, options), do: GenServer.cast(restarter, {:watch, key, tree, options})

  @doc "Stops watching a vehicle; after that its tree may be stopped."
  @spec forget(pid(), Store.vehicle_key()) :: :ok
  def forget(restarter, key), do: GenServer.call(restarter, {:forget, key})

  @doc """
  Stops a lost vehicle to make room for another one (`Aerie.Vehicle.Session.Capacity`), and returns which, or `:none`.
  One call at a time, so that two newcomers displace two vehicles.
  """
  @spec make_room(pid(), Store.vehicle_key()) :: {:ok, Store.vehicle_key()} | :none
  def make_room(restarter, newcomer), do: GenServer.call(restarter, {:make_room, newcomer})

  @impl GenServer
  def init(gateway) do
    Process.set_label({:restarter, gateway})
    # After a restart of this process, the trees are still there.
    watched =
      for {key, tree, options} <- Vehicle.Supervisor.Tree.all(gateway),
          into: %{},
          do: {Process.monitor(tree), entry(key, options)}

    {:ok, %{gateway: gateway, watched: watched}}
  end

  @impl GenServer
  def handle_cast({:watch, key, tree, options}, state) do
    {:noreply, put_in(state.watched[Process.monitor(tree)], entry(key, options))}
  end

  @impl GenServer
  def handle_call({:forget, key}, _from, state), do: {:reply, :ok, unwatch(state, key)}

  def handle_call({:make_room, newcomer}, _from, state) do
    case Vehicle.Session.Capacity.displaced_by(state.gateway, newcomer) do
      nil ->
        {:reply, :none, state}

      {key, lost_ms} ->
        state = unwatch(state, key)
        Vehicle.Supervisor.end_tree(state.gateway, key)
        Vehicle.Session.Capacity.report(state.gateway, key, newcomer, lost_ms)
        {:reply, {:ok, key}, state}
    end
  end

  defp unwatch(state, key) do
    {gone, kept} = Map.split_with(state.watched, fn {_ref, entry} -> entry.key == key end)
    Enum.each(Map.keys(gone), &Process.demonitor(&1, [:flush]))
    %{state | watched: kept}
  end

  @impl GenServer
  def handle_info({:DOWN, ref, :process, _tree, _reason}, state) do
    {entry, watched} = Map.pop(state.watched, ref)
    state = %{state | watched: watched}

    cond do
      entry == nil -> {:noreply, state}
      now() - entry.since > @healthy_ms -> {:noreply, start(state, %{entry | tries: 0})}
      entry.tries == 0 -> {:noreply, start(state, entry)}
      true -> {:noreply, later(state, entry)}
    end
  end

  # The wait is kept under a reference like a tree's monitor, so that forgetting a vehicle ends both.
  def handle_info({:restart, ref}, state) do
    case Map.pop(state.watched, ref) do
      {nil, _watched} -> {:noreply, state}
      {entry, watched} -> {:noreply, start(%{state | watched: watched}, entry)}
    end
  end

  defp start(state, entry) do
    {network, system} = entry.key
    Store.count(state.gateway, {:vehicles, :tree_restarts})
    metadata = %{gateway: state.gateway, network: network, system: system}
    :telemetry.execute([:aerie, :vehicle, :restart], %{count: 1}, metadata)
    child = {Vehicle.Supervisor.Tree, [gateway: state.gateway, key: entry.key] ++ entry.options}

    case DynamicSupervisor.start_child(Names.via(state.gateway, :vehicle_trees), child) do
      {:ok, tree} -> watch_again(state, tree, entry)
      {:error, {:already_started, tree}} -> watch_again(state, tree, entry)
      {:error, _reason} -> later(state, entry)
    end
  end

  defp watch_again(state, tree, entry) do
    put_in(state.watched[Process.monitor(tree)], %{entry | tries: entry.tries + 1, since: now()})
  end

  defp later(state, entry) do
    ref = make_ref()
    Process.send_after(self(), {:restart, ref}, Backoff.wait(entry.tries, @min_delay_ms, @max_delay_ms))
    put_in(state.watched[ref], %{entry | tries: entry.tries + 1})
  end

  defp entry(key, options), do: %{key: key, options: options, tries: 0, since: now()}

  defp now, do: System.monotonic_time(:millisecond)
end
