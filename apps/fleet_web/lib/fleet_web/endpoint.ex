defmodule FleetWeb.Endpoint do
  @moduledoc """
  The HTTP server of one gateway instance: Cowboy listeners under their own supervisor.

      FleetWeb.Endpoint.start_link(gateway: :default, settings: settings)

  * `gateway` - name of the `Aerie.Gateway` that it shows (required)
  * `settings` - `FleetWeb.Settings` (required); port 0 takes a free one, which `port/1` returns
  * `reload` - reads the configuration again (`POST /api/config/reload`); gets who asks
  * `max_connections` - default 1000; more wait in the kernel's queue
  * `configuration` - a function that gives the configuration for people (`t:FleetWeb.Console.Settings.Configuration.section/0`), for the
    page of settings; without it the page has none

  Cowboy (with its default limits on headers and request lines) and `FleetWeb.HTTP.Utf8Check` refuse bad input, which costs only
  its own connection. The server speaks HTTP/1.1 only, because no client of a gateway needs more.
  """

  use Supervisor

  alias FleetWeb.{Access, API, Console}
  alias FleetWeb.HTTP.{Compression, Handler, Proxy, Utf8Check}
  alias FleetWeb.{Listener, Settings}
  alias FleetWeb.WebSocket

  @defaults [max_connections: 1000, reload: nil, configuration: nil]

  @type option ::
          {:gateway, term()}
          | {:settings, Settings.t()}
          | {:max_connections, pos_integer()}
          | {:reload, (by :: String.t() -> {:ok, map()} | {:error, [String.t()]}) | nil}
          | {:configuration, (-> [Console.Settings.Configuration.section()]) | nil}

  @spec start_link([option()]) :: Supervisor.on_start()
  def start_link(options) do
    options = Keyword.validate!(options, [:gateway, :settings | @defaults])
    Supervisor.start_link(__MODULE__, options)
  end

  @doc "The port on which the server of `gateway` listens."
  @spec port(term()) :: :inet.port_number()
  defdelegate port(gateway), to: Listener

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{} = settings = Keyword.fetch!(options, :settings)

    with {:ok, keys} <- Access.Keys.load(settings.api),
         policy = policy(settings),
         {:ok, console, pages} <- console(gateway, settings, policy, options[:configuration]) do
      routes = routes(gateway, policy, options[:reload], pages)

      children =
        [
          {Access.KeyRing, key_ring(gateway, settings, keys)},
          {Access.Tickets, gateway: gateway},
          {FleetWeb.WorkLimit, gateway: gateway},
          {Aerie.Fleet.Diagnosis.Server, gateway: gateway}
        ] ++
          console ++
          [listener(gateway, settings, options[:max_connections], routes)] ++
          warnings(gateway, settings) ++
          WebSocket.listener(gateway, settings.websocket, policy)

      Supervisor.init(children, strategy: :one_for_one, max_restarts: 20, max_seconds: 10)
    else
      {:error, text} ->
        # Without readable keys the server would admit nobody, or everybody, so it does not start.
        raise ArgumentError, text
    end
  end

  # The console's processes, and what it serves.
  defp console(_gateway, %Settings{console: %{enabled: false}}, _policy, _configuration), do: {:ok, [], []}

  defp console(gateway, %Settings{console: console}, policy, configuration) do
    with {:ok, secret} <- Access.Secret.load(gateway, console.dir) do
      {:ok, [{Console.Supervisor, gateway: gateway, settings: console, configuration: configuration}],
       Console.Supervisor.routes(gateway, policy, secret)}
    end
  end

  # Only a listener that has started knows its port.
  defp warnings(_gateway, %Settings{console: %{enabled: false}}), do: []

  defp warnings(gateway, %Settings{http: http}) do
    tell = fn -> Access.Launch.write(gateway, Settings.ip(http.address)) end
    [%{id: :console_address, start: {__MODULE__, :run_once, [tell]}, restart: :transient}]
  end

  @doc false
  def run_once(fun) do
    fun.()
    :ignore
  end

  defp listener(gateway, %Settings{http: http}, max_connections, routes) do
    transport = %{
      socket_opts: [ip: Settings.ip(http.address), port: http.port],
      num_acceptors: 4,
      # Ranch applies the connection limit per connection supervisor, so there is only one.
      num_conns_sups: 1,
      max_connections: max_connections
    }

    protocol = %{
      env: %{
        dispatch: :cowboy_router.compile([{:_, routes}]),
        gateway: gateway,
        proxies: Enum.map(http.proxies, &Settings.ip/1)
      },
      middlewares: [Utf8Check, Proxy, :cowboy_router, :cowboy_handler],
      stream_handlers: [Compression, :cowboy_stream_h],
      protocols: [:http],
      idle_timeout: 30_000,
      # An unread body closes its connection; a slow one would hold it for ever.
      max_skip_body_length: 0,
      max_keepalive: 1000
    }

    {Listener, {Listener.ref(gateway), :ranch_tcp, transport, :cowboy_clear, protocol}}
  end

  # A request is decided by the keys of that moment.
  defp policy(%Settings{api: api, http: http}),
    do: %{keys: Access.KeyRing.nobody(), origins: api.origins, ports: [], hosts: http.hosts}

  defp key_ring(gateway, %Settings{console: %{dir: dir}}, keys),
    do: [gateway: gateway, configured: keys, file: Path.join(dir, "keys")]

  # The console takes every path that nobody else has.
  defp routes(gateway, policy, reload, console) do
    api =
      for {path, resource} <- API.Routes.paths(),
          do: {path, API.Handler, %{resource: resource, gateway: gateway, policy: policy, reload: reload}}

    plain = [{"/metrics", :metrics}, {"/healthz", :healthz}, {"/readyz", :readyz}]
    plain = if console == [], do: plain ++ [{"/", :index}, {:_, :missing}], else: plain

    api ++
      for({path, page} <- plain, do: {path, Handler, %{page: page, gateway: gateway, policy: policy}}) ++
      console
  end
end
