defmodule FleetWeb.Endpoint do
  @moduledoc """
  The HTTP server of one gateway instance: Cowboy listeners under their own supervisor.

      FleetWeb.Endpoint.start_link(gateway: :default, address: {127, 0, 0, 1}, port: 4000)

  * `gateway` - name of the `Aerie.Gateway` that it shows (required)
  * `address` - IP address to listen on, default `{127, 0, 0, 1}`, because there is no password by default
  * `port` - TCP port, default 4000; 0 takes a free one, which `port/1` returns
  * `max_connections` - default 1000; more wait in the kernel's queue
  * `config` - the `Aerie.Config`, or its sections `http`, `api` and `websocket`; default is the running gateway's. Without
    a section `websocket` there is no WebSocket listener

  Cowboy (with its default limits on headers and request lines) and `FleetWeb.HTTP.Guard` refuse bad input, which costs only
  its own connection. The server speaks HTTP/1.1 only, because no client of a gateway needs more.
  """

  use Supervisor

  alias Aerie.Client.Keys
  alias FleetWeb.API
  alias FleetWeb.HTTP.{Guard, Handler}
  alias FleetWeb.Listener
  alias FleetWeb.WebSocket

  @defaults [address: {127, 0, 0, 1}, port: 4000, max_connections: 1000, config: nil]

  @type option ::
          {:gateway, term()}
          | {:address, :inet.ip_address()}
          | {:port, :inet.port_number()}
          | {:max_connections, pos_integer()}
          | {:config, map() | nil}

  @spec start_link([option()]) :: Supervisor.on_start()
  def start_link(options) do
    options = Keyword.validate!(options, [:gateway | @defaults])
    Supervisor.start_link(__MODULE__, options)
  end

  @doc "The port on which the server of `gateway` listens."
  @spec port(term()) :: :inet.port_number()
  defdelegate port(gateway), to: Listener

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    config = options[:config] || Aerie.Gateway.config(gateway) || %{}

    case policy(config) do
      {:ok, policy} ->
        children =
          [{API.Tickets, gateway: gateway}, listener(gateway, options, policy)] ++
            WebSocket.listener(gateway, Map.get(config, :websocket), policy)

        Supervisor.init(children, strategy: :one_for_one)

      {:error, text} ->
        # Without readable keys the server would admit nobody, or everybody, so it does not start.
        raise ArgumentError, text
    end
  end

  defp listener(gateway, options, policy) do
    transport = %{
      socket_opts: [ip: options[:address], port: options[:port]],
      num_acceptors: 4,
      # Ranch applies the connection limit per connection supervisor, so there is only one.
      num_conns_sups: 1,
      max_connections: options[:max_connections]
    }

    protocol = %{
      env: %{dispatch: :cowboy_router.compile([{:_, routes(gateway, policy)}]), gateway: gateway},
      middlewares: Guard.middlewares(),
      protocols: [:http],
      idle_timeout: 30_000,
      # An unread body closes its connection; a slow one would hold it for ever.
      max_skip_body_length: 0,
      max_keepalive: 1000
    }

    :ranch.child_spec(Listener.ref(gateway), :ranch_tcp, transport, :cowboy_clear, protocol)
  end

  defp policy(config) do
    api = Map.get(config, :api) || %{key: nil, keys_file: nil, origins: []}
    hosts = Map.get(Map.get(config, :http) || %{}, :hosts, [])

    with {:ok, keys} <- Keys.load(api),
         do: {:ok, %{keys: keys, origins: api.origins, ports: [], hosts: hosts}}
  end

  defp routes(gateway, policy) do
    api =
      for {path, resource} <- API.Resources.paths(),
          do: {path, API.Handler, %{resource: resource, gateway: gateway, policy: policy}}

    pages =
      for {path, page} <- [
            {"/", :index},
            {"/metrics", :metrics},
            {"/healthz", :healthz},
            {"/readyz", :readyz},
            {:_, :missing}
          ],
          do: {path, Handler, %{page: page, gateway: gateway, policy: policy}}

    api ++ pages
  end
end
