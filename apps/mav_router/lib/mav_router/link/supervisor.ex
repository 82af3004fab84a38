defmodule MavRouter.Link.Supervisor do
  @moduledoc """
  All links of a gateway.

  ```
  MavRouter.Link.Supervisor     rest_for_one
  ├─ dynamic supervisor     one MavRouter.Link.Tree per link
  │    └─ MavRouter.Link.Tree   MavRouter.Recorder.Recording, MavRouter.Link.Server
  ├─ MavRouter.Link.Boot        starts the configured links, or those that ran before; then it ends
  └─ MavRouter.Link.Announcer   sends our heartbeat where nothing is heard yet
  ```
  """
  use Supervisor

  alias MavRouter.Link.Announcer
  alias MavRouter.Link.Boot
  alias MavRouter.Link.Server
  alias MavRouter.Link.Settings
  alias MavRouter.Link.Tree
  alias Aerie.Base.Names

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Link.Settings`)."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :links))
  end

  @doc "Starts a link's tree; options as `MavRouter.Link.Server.start_link/1`, without the gateway."
  @spec start_tree(Names.gateway(), keyword) ::
          {:ok, pid} | {:error, {:already_started, pid} | :max_children | :not_running | term}
  def start_tree(gateway, options) do
    trees = Names.via(gateway, :link_trees)

    case DynamicSupervisor.start_child(trees, {Tree, [gateway: gateway] ++ options}) do
      {:ok, tree} -> {:ok, tree}
      {:error, reason} -> {:error, reason}
    end
  catch
    :exit, _reason -> {:error, :not_running}
  end

  @doc "Ends a link's tree. An unknown link is fine."
  @spec stop_tree(Names.gateway(), String.t()) :: :ok
  def stop_tree(gateway, id) do
    case Names.whereis(gateway, :link_tree, id) do
      nil -> :ok
      tree -> terminate(Names.via(gateway, :link_trees), tree, id)
    end
  end

  @doc "Ends a link's process and starts it again, in its tree."
  @spec restart(Names.gateway(), String.t()) :: :ok | {:error, :unknown | term}
  def restart(gateway, id) do
    with tree when is_pid(tree) <- Names.whereis(gateway, :link_tree, id),
         :ok <- Supervisor.terminate_child(tree, Server),
         {:ok, _pid} <- Supervisor.restart_child(tree, Server) do
      :ok
    else
      nil -> {:error, :unknown}
      {:error, reason} -> {:error, reason}
    end
  catch
    :exit, _gone -> {:error, :unknown}
  end

  defp terminate(trees, tree, id) do
    :ok = Tree.drain(tree, id)
    _ = DynamicSupervisor.terminate_child(trees, tree)
    :ok
  catch
    :exit, _reason -> :ok
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:links, gateway})
    Settings.put(gateway, settings)

    children = [
      # Trees restart their links themselves, so this restarts a tree only if somebody kills it.
      {DynamicSupervisor,
       name: Names.via(gateway, :link_trees),
       max_children: settings.max_links,
       max_restarts: 100,
       max_seconds: 1},
      {Boot, gateway: gateway, links: settings.links, start: &start_tree/2},
      {Announcer, gateway: gateway, settings: settings.identity}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end
end
