defmodule Phoenix.LiveView.Server do
  @moduledoc """
  The server of pages: a value that is made once and given to Cowboy (`Phoenix.LiveView.Cowboy.routes/1`). It takes the
  place of an endpoint in Phoenix.

    * `:router`: a module that uses `Phoenix.Router`
    * `:secret`: at least 32 random bytes; tokens and cookies are signed with keys made from it
    * `:root_layout`: `{module, name}` of the component around every page, with `@inner_content`, `@page_title` and `@csrf_token`
    * `:session`: a function of the Cowboy request that returns the session (who is signed in), a string-keyed map
    * `:origin?`: a function of the Cowboy request: whether a WebSocket from its `Origin` may be opened
    * `:supervisor`: the `DynamicSupervisor` of the views' processes
    * `:cookie`: the name of the session cookie; `:not_found`: the HTML of the answer 404, `:too_many` that of 429
    * `:opened`: a function of the session, called in the process of each WebSocket when it opens, to subscribe to what ends a session;
      `:over?`: a function of a message to that process and the session: `{:close, ms}` if it means that the session is over, else false
    * `:priority`: the priority of the views' processes, `:normal`
    * `:max_channels` of one WebSocket, 8; `:max_frame` in bytes, 262,144; `:max_events` a second, 100; `:idle_ms` without a heartbeat, 90,000
    * `:render_ms`: the shortest time between two renderings that no event asked for, 50
    * `:csp`: the Content-Security-Policy of pages
  """

  @derive {Inspect, only: [:router]}
  @enforce_keys [:router, :secret, :supervisor]
  defstruct [
    :router,
    :secret,
    :supervisor,
    :root_layout,
    :not_found,
    :too_many,
    cookie: "_live_view",
    session: &__MODULE__.no_session/1,
    opened: &__MODULE__.no_session/1,
    over?: &__MODULE__.never_over/2,
    priority: :normal,
    origin?: &__MODULE__.same_origin?/1,
    max_channels: 8,
    max_frame: 262_144,
    max_events: 100,
    idle_ms: 90_000,
    render_ms: 50,
    csp:
      "default-src 'self'; img-src 'self' data: blob:; worker-src 'self' blob:; frame-ancestors 'none'; base-uri 'self'; form-action 'self'"
  ]

  @type t :: %__MODULE__{}

  @doc "Checks the options."
  @spec new(keyword()) :: t()
  def new(options) do
    server = struct!(__MODULE__, options)

    if byte_size(server.secret) < 32,
      do: raise(ArgumentError, "secret: expected at least 32 bytes, got #{byte_size(server.secret)}"),
      else: server
  end

  @doc false
  def no_session(_request), do: %{}

  @doc false
  def never_over(_message, _session), do: false

  @doc "Whether the `Origin` of a request is the server's own. A request without one comes from no page."
  @spec same_origin?(:cowboy_req.req()) :: boolean()
  def same_origin?(request) do
    case :cowboy_req.header("origin", request) do
      :undefined -> true
      origin -> own?(URI.new(origin), :cowboy_req.host(request), :cowboy_req.port(request))
    end
  end

  defp own?({:ok, %URI{scheme: scheme, host: host, port: port}}, host, port) when scheme in ["http", "https"],
    do: true

  defp own?(_other, _host, _port), do: false
end
