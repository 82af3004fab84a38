defmodule Aerie.Vehicle.Supervisor do
  @moduledoc """
  Starts the process tree of a vehicle when its autopilot is first heard, and keeps it running.

  ```
  Aerie.Vehicle.Supervisor        rest_for_one
  ├─ dynamic supervisor           one Supervisor.Tree (temporary) per {network, system_id}, at most `max_vehicles`
  ├─ Supervisor.TreeRestarter     restarts a tree that died: at once, then with growing delays
  └─ MavRouter.Identity.Watchdog  asks all loops whether they answer, which the gateway's heartbeat vouches for
  ```

  The trees are temporary, so that a vehicle whose frames crash its session again and again cannot use up a restart
  budget that all vehicles share; the restarter bounds how often it is started.
  """
  use Supervisor
  @behaviour MavRouter.Router.Vehicles

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.Journal
  alias MavRouter.Identity

  @doc """
  Options: `:gateway`, `:settings`, `:publisher` (the module of `Aerie.Vehicle.Session.Publisher`; none when absent),
  `:loops` (modules of further processes of each vehicle's tree, which are linked to the others; none when absent),
  `:arming` (the module of `Aerie.Vehicle.Session.ArmAuthorization`; without one no vehicle that asks may arm).
  """
  @spec start_link(
          gateway: Names.gateway(),
          settings: Vehicle.Settings.t(),
          publisher: module(),
          loops: [module()],
          arming: module()
        ) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :vehicles))
  end

  @doc """
  Makes sure that a vehicle has its tree, and returns its session.

  Any number of processes may call this at once; all get the same session. `options` override what the configuration
  says about the vehicle (`Aerie.Vehicle.Options`). Errors: `:too_many` if there are `max_vehicles` and none of them
  makes room (`Aerie.Vehicle.Session.Capacity`; counted as `{:vehicles, :refused}`), `:not_running` if the gateway is
  stopping or its vehicles are being restarted.
  """
  @impl MavRouter.Router.Vehicles
  @spec ensure(Names.gateway(), Store.vehicle_key(), keyword()) ::
          {:ok, pid()} | {:error, :too_many | :not_running}
  def ensure(gateway, {_network, _system} = key, options \\ []) do
    case Names.whereis(gateway, :session, key) do
      nil -> start(gateway, key, options)
      session -> {:ok, session}
    end
  end

  @doc "Stops a vehicle's tree and deletes its snapshot. Does nothing for an unknown vehicle."
  @spec remove(Names.gateway(), Store.vehicle_key()) :: :ok
  def remove(gateway, key) do
    with restarter when is_pid(restarter) <- Names.whereis(gateway, :tree_restarter),
         do: Vehicle.Supervisor.TreeRestarter.forget(restarter, key)

    end_tree(gateway, key)
  end

  @doc false
  # For the restarter, which must not watch the tree any more.
  @spec end_tree(Names.gateway(), Store.vehicle_key()) :: :ok
  def end_tree(gateway, key) do
    # The tree may have died meanwhile.
    _ended =
      with tree when is_pid(tree) <- Names.whereis(gateway, :tree, key) do
        DynamicSupervisor.terminate_child(Names.via(gateway, :vehicle_trees), tree)
      end

    Journal.forget_vehicle(gateway, Vehicle.Options.id(Vehicle.Settings.of(gateway), key))
    Store.forget(gateway, {:lost, key})
    Store.forget(gateway, {:commanded, Vehicle.Options.id(Vehicle.Settings.of(gateway), key)})
    :ok = Store.delete_vehicle(gateway, key)
    # Afterwards, so that its recording is not begun again.
    MavRouter.Recorder.forget(gateway, key)
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:vehicles, gateway})
    %Vehicle.Settings{} = settings = Keyword.fetch!(options, :settings)
    Vehicle.Settings.put(gateway, settings, Map.new(Keyword.take(options, [:publisher, :arming, :loops])))

    children = [
      {DynamicSupervisor, name: Names.via(gateway, :vehicle_trees), max_children: settings.max_vehicles},
      {Vehicle.Supervisor.TreeRestarter, gateway: gateway},
      {Identity.Watchdog, gateway: gateway, settings: settings.identity}
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
    # The dynamic supervisor is being restarted, or the gateway is stopping.
    :exit, _reason -> {:error, :not_running}
  end

  defp room?(gateway, key) do
    restarter = Names.whereis(gateway, :tree_restarter)
    restarter != nil and Vehicle.Supervisor.TreeRestarter.make_room(restarter, key) != :none
  end

  defp refused(gateway) do
    Store.count(gateway, {:vehicles, :refused})
    {:error, :too_many}
  end

  defp try_start(gateway, key, options) do
    child = {Vehicle.Supervisor.Tree, [gateway: gateway, key: key] ++ options}

    case DynamicSupervisor.start_child(Names.via(gateway, :vehicle_trees), child) do
      {:ok, tree} ->
        with restarter when is_pid(restarter) <- Names.whereis(gateway, :tree_restarter) do
          Vehicle.Supervisor.TreeRestarter.watch(restarter, key, tree, options)
        end

        session(gateway, key)

      # Another process was faster, or the tree is restarting its session.
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
