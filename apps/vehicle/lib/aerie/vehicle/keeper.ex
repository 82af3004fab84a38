defmodule Aerie.Vehicle.Keeper do
  @moduledoc """
  Starts a vehicle's tree again when it died.

  The first time at once, then after 250 ms, 500 ms … up to 30 s with up to a quarter of jitter; a tree that lived for ten
  seconds counts as new. A tree that is to stay ended is forgotten first (`forget/2`); no reason of its end tells that,
  because a supervisor that gives up says `:shutdown` too.

  It also ends a lost vehicle's tree when another one needs its place (`Aerie.Vehicle.Places`).
  """
  use GenServer

  alias Aerie.{Names, Store, Vehicle}

  @first_delay_ms 250
  @max_delay_ms 30_000
  @healthy_ms 10_000

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :keeper))
  end

  @doc "Watches a tree that was started with these options."
  @spec watch(pid(), Store.vehicle_key(), pid(), keyword()) :: :ok
  def watch(keeper, key, tree, options), do: GenServer.cast(keeper, {:watch, key, tree, options})

  @doc "Stops watching a vehicle; when this returns its tree may be ended."
  @spec forget(pid(), Store.vehicle_key()) :: :ok
  def forget(keeper, key), do: GenServer.call(keeper, {:forget, key})

  @doc """
  Ends a lost vehicle for the sake of one that finds no place (`Aerie.Vehicle.Places`); which, or that there is none. One
  at a time, so that two newcomers displace two.
  """
  @spec make_room(pid(), Store.vehicle_key()) :: {:ok, Store.vehicle_key()} | :none
  def make_room(keeper, newcomer), do: GenServer.call(keeper, {:make_room, newcomer})

  @impl GenServer
  def init(gateway) do
    Process.set_label({:keeper, gateway})
    # After a restart of its own: the trees live on, their options are asked of them.
    watched =
      for {key, tree, options} <- Vehicle.Tree.all(gateway),
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
    case Vehicle.Places.taken_by(state.gateway, newcomer) do
      nil ->
        {:reply, :none, state}

      {key, lost_ms} ->
        state = unwatch(state, key)
        Vehicle.Supervisor.end_tree(state.gateway, key)
        Vehicle.Places.tell(state.gateway, key, newcomer, lost_ms)
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

  # The reference stands for the wait as it stood for the tree, so that forgetting a vehicle ends both.
  def handle_info({:again, ref}, state) do
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
    child = {Vehicle.Tree, [gateway: state.gateway, key: entry.key] ++ entry.options}

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
    Process.send_after(self(), {:again, ref}, delay(entry.tries))
    put_in(state.watched[ref], %{entry | tries: entry.tries + 1})
  end

  defp delay(tries) do
    delay = min(@first_delay_ms * Integer.pow(2, min(max(tries - 1, 0), 10)), @max_delay_ms)
    delay + :rand.uniform(div(delay, 4))
  end

  defp entry(key, options), do: %{key: key, options: options, tries: 0, since: now()}

  defp now, do: System.monotonic_time(:millisecond)
end
