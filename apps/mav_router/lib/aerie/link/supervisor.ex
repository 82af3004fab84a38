defmodule Aerie.Link.Supervisor do
  @moduledoc """
  All links of a gateway.

  ```
  Aerie.Link.Supervisor     rest_for_one
  ├─ dynamic supervisor     one Aerie.Link.Tree per link
  │    └─ Aerie.Link.Tree   Aerie.Recorder.Recording, Aerie.Link.Server
  ├─ Aerie.Link.Boot        starts the configured links, or those that ran before; then ends
  └─ Aerie.Link.Announcer   our heartbeat where nothing is heard yet
  ```
  """
  use Supervisor

  alias Aerie.Link.Announcer
  alias Aerie.Link.Boot
  alias Aerie.Link.Defaults
  alias Aerie.Link.Tree
  alias Aerie.Names

  @default_max_links 64

  @doc "Options: `:gateway`, `:config`."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :links))
  end

  @doc "Starts a link's tree; options as `Aerie.Link.Server.start_link/1`, without the gateway."
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
      tree -> terminate(Names.via(gateway, :link_trees), tree)
    end
  end

  defp terminate(trees, tree) do
    _ = DynamicSupervisor.terminate_child(trees, tree)
    :ok
  catch
    :exit, _reason -> :ok
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    config = Keyword.get(options, :config)
    Process.set_label({:links, gateway})
    Defaults.put(gateway, Defaults.from(config))

    children = [
      # Its trees restart their links themselves, so that it has to restart a tree only when somebody kills that.
      {DynamicSupervisor,
       name: Names.via(gateway, :link_trees),
       max_children: max_links(config),
       max_restarts: 100,
       max_seconds: 1},
      {Boot, gateway: gateway, config: config},
      {Announcer, gateway: gateway, config: config}
    ]

    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end

  defp max_links(%{limits: %{max_links: max}}), do: max
  defp max_links(_none), do: @default_max_links
end
