defmodule Aerie.Api.Endpoint do
  @moduledoc """
  The HTTP server of one gateway instance: Cowboy listeners under their own supervisor.

      Aerie.Api.Endpoint.start_link(gateway: :default, settings: settings)

  * `gateway` - name of the `Aerie.Gateway` that it shows (required)
  * `settings` - `Aerie.Api.Settings` (required); port 0 takes a free one, which `port/1` returns
  * `reload` - reads the configuration again (`POST /api/config/reload`); gets who asks
  * `max_connections` - default 1000; more wait in the kernel's queue
  * `pages` - the console: a function that gives its processes and routes for the port's policy; without it, or while it is switched off,
    there is an index in its place

  Cowboy (with its default limits on headers and request lines) and `Aerie.Access.HTTP.Utf8Check` refuse bad input, which costs only
  its own connection. The server speaks HTTP/1.1 only, because no client of a gateway needs more.
  """

  use Supervisor

  alias Aerie.Access
  alias Aerie.Access.HTTP.{Admission, Compression, Proxy, Utf8Check}
  alias Aerie.Api.{Listener, Monitoring, Rest, Settings, WebSocket}

  @defaults [max_connections: 1000, reload: nil, pages: nil]

  @type option ::
          {:gateway, term()}
          | {:settings, Settings.t()}
          | {:max_connections, pos_integer()}
          | {:reload, (by :: String.t() -> {:ok, map()} | {:error, [String.t()]}) | nil}
          | {:pages, pages() | nil}

  @typedoc "The console's processes and routes, or why it cannot be served."
  @type pages ::
          (Admission.policy() -> {:ok, [Supervisor.module_spec()], [tuple()]} | {:error, String.t()})

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
         {:ok, console, pages} <- console(settings, policy, options[:pages]) do
      routes = routes(gateway, policy, options[:reload], pages)

      children =
        [
          {Access.KeyRing, key_ring(gateway, settings, keys)},
          {Access.Tickets, gateway: gateway},
          {Access.WorkLimit, gateway: gateway},
          {Aerie.Fleet.Diagnosis, gateway: gateway}
        ] ++
          console ++
          [listener(gateway, settings, options[:max_connections], routes)] ++
          warnings(gateway, settings, console) ++
          WebSocket.listener(gateway, settings.websocket, policy)

      Supervisor.init(children, strategy: :one_for_one, max_restarts: 20, max_seconds: 10)
    else
      {:error, text} ->
        # Without readable keys the server would admit nobody, or everybody, so it does not start.
        raise ArgumentError, text
    end
  end

  defp console(%Settings{console: %{enabled: true}}, policy, pages) when pages != nil, do: pages.(policy)
  defp console(_settings, _policy, _pages), do: {:ok, [], []}

  # Only a listener that has started knows its port.
  defp warnings(_gateway, _settings, []), do: []

  defp warnings(gateway, %Settings{http: http}, _console) do
    tell = fn -> Access.Launch.write(gateway, Settings.ip(http.address), port(gateway)) end
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
      for {path, resource} <- Rest.Routes.paths(),
          do: {path, Rest.Handler, %{resource: resource, gateway: gateway, policy: policy, reload: reload}}

    plain = [{"/metrics", :metrics}, {"/healthz", :healthz}, {"/readyz", :readyz}]
    plain = if console == [], do: plain ++ [{"/", :index}, {:_, :missing}], else: plain

    api ++
      for({path, page} <- plain, do: {path, Monitoring, %{page: page, gateway: gateway, policy: policy}}) ++
      console
  end
end
