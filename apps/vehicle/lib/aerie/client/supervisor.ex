defmodule Aerie.Client.Supervisor do
  @moduledoc """
  What serves programs on this machine by unix sockets. Nothing else of the gateway depends on it, so it is the last
  child of the gateway, and its end costs only its clients' connections.
  """
  use Supervisor

  alias Aerie.Client.{MavlinkClient, StateClient, StateFeed, UnixListener, UnixSocket}
  alias Aerie.Names

  @doc "Options: `:gateway`, `:config`."
  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :clients))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:clients, gateway})
    children = sockets(gateway, Map.get(Keyword.fetch!(options, :config), :sockets))
    Supervisor.init(children, strategy: :one_for_one, max_restarts: 20, max_seconds: 10)
  end

  defp sockets(gateway, %{enabled: true} = settings) do
    dir = Path.expand(settings.dir || UnixSocket.default_dir(System.get_env()))

    [{StateFeed, gateway: gateway, hz: settings.state_hz}] ++
      socket(gateway, :state, StateClient, dir, settings) ++
      socket(gateway, :mavlink, MavlinkClient, dir, settings)
  end

  defp sockets(_gateway, _off), do: []

  # The clients' supervisor is found by its name, so that it and the listener may die independently.
  defp socket(gateway, socket, client, dir, settings) do
    clients = Names.via(gateway, :socket_clients, socket)
    child = {client, gateway: gateway}

    [
      Supervisor.child_spec(
        {DynamicSupervisor, name: clients, strategy: :one_for_one, max_children: settings.max_clients},
        id: {:clients, socket}
      ),
      {UnixListener,
       gateway: gateway,
       socket: socket,
       path: Path.join(dir, "#{socket}.sock"),
       chosen: settings.dir != nil,
       start: fn -> DynamicSupervisor.start_child(clients, child) end}
    ]
  end
end
