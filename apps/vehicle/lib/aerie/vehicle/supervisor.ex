defmodule Aerie.Vehicle.Supervisor do
  @moduledoc """
  Starts the tree of a vehicle when its autopilot is first heard, and keeps it running.

  ```
  Aerie.Vehicle.Supervisor        rest_for_one
  ├─ dynamic supervisor           one Aerie.Vehicle.Tree (temporary) per {network, system_id}, at most `max_vehicles`
  ├─ Aerie.Vehicle.Keeper         starts a tree that died again: at once, then with a growing delay
  └─ Aerie.Identity.Pulse asks all loops whether they still turn: what the gateway's heartbeat stands for
  ```

  The trees are temporary so that one vehicle whose frames crash its session over and over never uses up a restart
  budget that all vehicles share; the keeper bounds how often it is tried.
  """
  use Supervisor
  @behaviour Aerie.Router.Vehicles

  alias Aerie.{Fleet, Identity, Names, Store, Vehicle}

  @default_max_vehicles 256

  @spec start_link(gateway: Names.gateway(), config: term()) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :vehicles))
  end

  @doc """
  Makes sure that a vehicle has its tree; gives its session.

  May be called by any number of processes at once; all get the same session. `options` refine what the configuration
  says about the vehicle (see `Aerie.Vehicle.Options`). Errors: `:too_many` when `max_vehicles` are there and none of
  them makes room (`Aerie.Vehicle.Places`; counted as `{:vehicles, :refused}`), `:not_running` when the gateway is going down or its vehicles are being restarted.
  """
  @impl Aerie.Router.Vehicles
  @spec ensure(Names.gateway(), Store.vehicle_key(), keyword()) ::
          {:ok, pid()} | {:error, :too_many | :not_running}
  def ensure(gateway, {_network, _system} = key, options \\ []) do
    case Names.whereis(gateway, :session, key) do
      nil -> start(gateway, key, options)
      session -> {:ok, session}
    end
  end

  @doc "Ends a vehicle's tree and forgets its snapshot. Unknown vehicles are fine."
  @spec remove(Names.gateway(), Store.vehicle_key()) :: :ok
  def remove(gateway, key) do
    with keeper when is_pid(keeper) <- Names.whereis(gateway, :keeper), do: Vehicle.Keeper.forget(keeper, key)
    end_tree(gateway, key)
  end

  @doc false
  # For the keeper, which must not watch the tree any more.
  @spec end_tree(Names.gateway(), Store.vehicle_key()) :: :ok
  def end_tree(gateway, key) do
    # It may have ended by itself meanwhile.
    _ended =
      with tree when is_pid(tree) <- Names.whereis(gateway, :tree, key) do
        DynamicSupervisor.terminate_child(Names.via(gateway, :vehicle_trees), tree)
      end

    Fleet.Journal.forget_vehicle(gateway, Vehicle.Options.id(Aerie.RunningConfig.of(gateway), key))
    Store.forget(gateway, {:lost, key})
    Aerie.Recorder.forget(gateway, key)
    Store.delete_vehicle(gateway, key)
  end

  @doc "Keys of the vehicles that have a tree."
  @spec keys(Names.gateway()) :: [Store.vehicle_key()]
  def keys(gateway) do
    Registry.select(Aerie.Registry, [{{{gateway, :tree, :"$1"}, :_, :_}, [], [:"$1"]}])
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:vehicles, gateway})
    Names.put_value(gateway, :vehicles, Keyword.get(options, :fleet))
    max = Vehicle.Options.max_vehicles(Keyword.get(options, :config)) || @default_max_vehicles

    children = [
      {DynamicSupervisor, name: Names.via(gateway, :vehicle_trees), max_children: max},
      {Vehicle.Keeper, gateway: gateway},
      {Identity.Pulse, gateway: gateway, config: Keyword.get(options, :config)}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end

  defp start(gateway, key, options) do
    with {:error, :too_many} <- try_start(gateway, key, options),
         true <- room?(gateway, key),
         {:error, :too_many} <- try_start(gateway, key, options) do
      refused(gateway)
    else
      false -> refused(gateway)
      started -> started
    end
  catch
    # The dynamic supervisor is being restarted or the gateway goes down.
    :exit, _reason -> {:error, :not_running}
  end

  defp room?(gateway, key) do
    keeper = Names.whereis(gateway, :keeper)
    keeper != nil and Vehicle.Keeper.make_room(keeper, key) != :none
  end

  defp refused(gateway) do
    Store.count(gateway, {:vehicles, :refused})
    {:error, :too_many}
  end

  defp try_start(gateway, key, options) do
    child = {Vehicle.Tree, [gateway: gateway, key: key] ++ options}

    case DynamicSupervisor.start_child(Names.via(gateway, :vehicle_trees), child) do
      {:ok, tree} ->
        with keeper when is_pid(keeper) <- Names.whereis(gateway, :keeper) do
          Vehicle.Keeper.watch(keeper, key, tree, options)
        end

        session(gateway, key)

      # Somebody else was faster, or the tree is just restarting its session.
      {:error, {:already_started, _tree}} ->
        session(gateway, key)

      {:error, :max_children} ->
        {:error, :too_many}

      {:error, _reason} ->
        {:error, :not_running}
    end
  end

  defp session(gateway, key) do
    case Names.whereis(gateway, :session, key) do
      nil -> {:error, :not_running}
      session -> {:ok, session}
    end
  end
end
