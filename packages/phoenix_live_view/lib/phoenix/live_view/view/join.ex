defmodule Phoenix.LiveView.View.Join do
  @moduledoc """
  Handles `phx_join` of a page's WebSocket: returns a mounted view with its first tree, or the reason of the refusal,
  in the client's form.

  A page that was loaded joins with its `url`, which must still lead to the view of its token: after a change of the
  program the page has to load again. A page to which the client navigated joins with `redirect`, and gets the view of
  that URL if it belongs to the same `live_session`.
  """

  alias Phoenix.LiveView.{Router, Server, Socket, Token, View}

  @session_age_s 12 * 3600

  @doc "`info`: what the transport knows about the connection (`:session`, `:peer_data` …)."
  @spec join(Server.t(), String.t(), map(), map(), pid()) :: {:ok, map(), View.t()} | {:error, map()}
  def join(server, topic, payload, info, transport) do
    with {:ok, token} <- session(server, topic, payload),
         {:ok, how, uri} <- uri(payload),
         {:ok, route} <- route(server, token, how, uri) do
      mount(server, token, route, uri, payload, info, transport)
    else
      {:error, reason} -> {:error, %{reason: reason}}
    end
  end

  defp session(server, topic, payload) do
    case Token.verify(server.secret, "session", payload["session"], @session_age_s) do
      {:ok, %{id: id} = token} when topic == "lv:" <> id -> {:ok, token}
      {:ok, _of_another_page} -> {:error, "unauthorized"}
      {:error, _expired_or_invalid} -> {:error, "stale"}
    end
  end

  defp uri(payload) do
    {how, url} =
      if is_binary(payload["redirect"]), do: {:redirect, payload["redirect"]}, else: {:url, payload["url"]}

    with true <- is_binary(url) and byte_size(url) <= 8_192,
         {:ok, %URI{scheme: scheme} = uri} when scheme in ["http", "https"] <- URI.new(url) do
      {:ok, how, uri}
    else
      _no_url -> {:error, "unauthorized"}
    end
  end

  defp route(server, token, how, uri) do
    case {how, Router.match(server.router, uri.path || "/")} do
      {:redirect, {:ok, %{session: %{name: name}} = route}} when name == token.live_session -> {:ok, route}
      {:url, {:ok, %{view: view} = route}} when view == token.view -> {:ok, route}
      _other -> {:error, "unauthorized"}
    end
  end

  defp mount(server, token, route, uri, payload, info, transport) do
    params = if is_map(payload["params"]), do: payload["params"], else: %{}

    # The first join gets the flash that the page was loaded with.
    flash = if params["_mounts"] == 0 and payload["redirect"] == nil, do: token.flash, else: %{}
    private = %{connect_info: info}
    socket = Socket.new(server, route, uri, flash, id: token.id, transport_pid: transport, private: private)

    case View.mount(%View{server: server, route: route, socket: socket}, uri, info[:session] || %{}) do
      {:ok, view} ->
        patched = view.patched
        {tree, view} = View.joined(view)
        response = %{rendered: tree, liveview_version: version()}
        response = if patched, do: Map.put(response, :live_patch, patched), else: response
        {:ok, response, %{view | patched: nil}}

      {:away, target, view} ->
        target = View.elsewhere(server, target, view.socket.assigns.flash)
        events = Enum.reverse(view.socket.private[:push_events] || [])
        {:error, if(events == [], do: %{redirect: target}, else: %{redirect: target, events: events})}
    end
  rescue
    error -> refused(server, error, __STACKTRACE__)
  end

  # The client loads the page, which then answers with the status.
  defp refused(server, %{plug_status: status}, _trace) when status in 400..499,
    do: {:error, %{reason: "reload", status: status, token: Token.sign(server.secret, "reload", status)}}

  defp refused(_server, error, trace), do: reraise(error, trace)

  @version Mix.Project.config()[:version]
  @doc "The client version that this package serves."
  @spec version() :: String.t()
  def version, do: @version
end
