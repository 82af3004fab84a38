defmodule Phoenix.LiveView.View do
  @moduledoc """
  One view between its callbacks, as a value: takes inputs and returns actions for the client. It has no process and no socket:
  `Phoenix.LiveView.Channel` carries out the actions, and a dead rendering uses `mount/3` and `render/1` alone.

  Actions, in order:

    * `{:reply, map}`: the answer to the event that is being handled
    * `{:push, event, map}`: a message for the client
    * `{:refused, words}`: the client's message is invalid; count and log it
    * `:stop`: the view ends; the client navigates elsewhere
  """

  alias Phoenix.LiveView
  alias Phoenix.LiveView.{Diff, Query, Rendered, Router, Server, Socket, Token}
  alias Phoenix.LiveView.View.Lifecycle

  require Logger

  @enforce_keys [:socket, :server, :route]
  defstruct [:socket, :server, :route, :uri, :sent, :patched]

  @type t :: %__MODULE__{}
  @type action :: {:reply, map()} | {:push, String.t(), map()} | {:refused, String.t()} | :stop
  # A view that patches itself every time would never finish.
  @max_patches 20

  @doc """
  Runs `on_mount`, `mount` and `handle_params`. `{:away, navigation, view}` if the view navigates elsewhere at once.
  """
  @spec mount(t(), URI.t(), map()) :: {:ok, t()} | {:away, %{to: String.t()}, t()}
  def mount(%__MODULE__{route: route, socket: socket} = view, uri, session) do
    {:module, module} = Code.ensure_loaded(route.view)
    params = params(route, uri)

    with {:cont, socket} <- Lifecycle.mount(route.session.on_mount, params, session, socket),
         {:ok, %Socket{redirected: nil} = socket} <- user_mount(module, params, session, socket) do
      arrive(%{view | socket: socket}, uri, params)
    else
      {_halt_or_ok, %Socket{} = socket} -> away(%{view | socket: socket})
    end
  end

  defp user_mount(module, params, session, socket) do
    if function_exported?(module, :mount, 3), do: module.mount(params, session, socket), else: {:ok, socket}
  end

  defp away(%{socket: %{redirected: {_kind, target}}} = view), do: {:away, Map.take(target, [:to]), view}

  # The first handle_params, and those of the patches that it requests.
  defp arrive(view, uri, params) do
    view = handle_params(%{view | uri: uri}, params)

    case patches(view, []) do
      {%{socket: %{redirected: nil}} = view, patches} -> {:ok, %{view | patched: List.first(patches)}}
      {view, _patches} -> away(view)
    end
  end

  @doc "The page for a client that joins."
  @spec joined(t()) :: {map(), t()}
  def joined(view) do
    rendered = render(view)
    tree = rendered |> Diff.root() |> extras(view)
    {tree, settle(view, rendered)}
  end

  @doc "The rendered page, for a dead rendering."
  @spec render(t()) :: Rendered.t()
  def render(%__MODULE__{socket: socket, route: route}) do
    assigns = Map.put(socket.assigns, :socket, socket)
    rendered = route.view.render(assigns)

    case route.session.layout do
      {module, name} -> apply(module, name, [Map.put(assigns, :inner_content, rendered)])
      nil -> rendered
    end
  end

  @doc "Handles an event of the client, whose type decides how its value is read."
  @spec event(t(), map()) :: {[action()], t()}
  def event(view, %{"event" => "lv:clear-flash"} = payload) do
    socket =
      case payload["value"] do
        %{"key" => kind} when is_binary(kind) -> LiveView.clear_flash(view.socket, kind)
        _all -> LiveView.clear_flash(view.socket)
      end

    finish(%{view | socket: socket}, :reply)
  end

  def event(view, %{"event" => event} = payload) when is_binary(event) do
    case value(payload) do
      {:ok, value} -> handle_event(view, event, value)
      {:error, words} -> refuse(view, "the value of event #{inspect(event)}: #{words}")
    end
  end

  def event(view, payload), do: refuse(view, "no event: #{inspect(payload, limit: 5, printable_limit: 100)}")

  # The client waits for an answer, and an error would lock the element for ever.
  defp refuse(view, words) do
    {actions, view} = flush(view)
    {actions ++ [{:refused, words}], view}
  end

  @doc "An answer with only the pending changes."
  @spec flush(t()) :: {[action()], t()}
  def flush(view), do: finish(view, :reply)

  defp handle_event(%{socket: socket, route: route} = view, event, value) do
    {outcome, %Socket{} = socket} =
      with {:cont, socket} <- Lifecycle.run(socket, :handle_event, [event, value]),
           do: route.view.handle_event(event, value, socket)

    true = outcome in [:noreply, :halt]
    finish(%{view | socket: socket}, :reply)
  end

  defp value(%{"type" => "form", "value" => text} = payload) when is_binary(text) do
    with {:ok, params} <- Query.decode(text) do
      {:ok, params |> Map.merge(meta(payload)) |> target()}
    end
  end

  defp value(%{"value" => value} = payload) when is_map(value), do: {:ok, Map.merge(value, meta(payload))}
  defp value(%{"value" => value}), do: {:ok, value}
  defp value(_none), do: {:ok, %{}}

  defp meta(%{"meta" => meta}) when is_map(meta), do: meta
  defp meta(_none), do: %{}

  defp target(%{"_target" => target} = params) when is_binary(target) and target != "undefined",
    do: %{params | "_target" => Query.path(target)}

  defp target(params), do: Map.delete(params, "_target")

  @doc "Handles the client's navigation to another URL of this page (a link, back or forward)."
  @spec patch(t(), map()) :: {[action()], t()}
  def patch(%{server: server, route: route} = view, %{"url" => url}) when is_binary(url) do
    with {:ok, uri} <- URI.new(url),
         {:ok, next} <- Router.match(server.router, uri.path || "/"),
         true <- next.view == route.view and next.session.name == route.session.name do
      view = %{view | socket: LiveView.clear_flash(view.socket), route: next, uri: uri}
      finish(handle_params(view, params(next, uri)), :reply)
    else
      # The client navigates to another page by itself.
      _other -> {[{:reply, %{link_redirect: true}}], view}
    end
  end

  def patch(view, _payload), do: refuse(view, "live_patch without a url")

  @doc "Handles a message to the view's process without rendering (`refresh/1`)."
  @spec message(t(), term()) :: t()
  def message(%{socket: socket, route: route} = view, message) do
    case Lifecycle.run(socket, :handle_info, [message]) do
      {:cont, socket} ->
        %{view | socket: handle_info(route.view, message, socket)}

      {:halt, socket} ->
        %{view | socket: socket}
    end
  end

  defp handle_info(module, message, socket) do
    if function_exported?(module, :handle_info, 2) do
      {:noreply, %Socket{} = socket} = module.handle_info(message, socket)
      socket
    else
      Logger.warning(
        "#{inspect(module)} has no handle_info/2 and got a message: #{inspect(message, limit: 5)}"
      )

      socket
    end
  end

  @doc "The number of queued events for hooks, which no later rendering replaces."
  @spec kept(t()) :: non_neg_integer()
  def kept(%{socket: %{private: private}}), do: length(private[:push_events] || [])

  @doc "Renders, and returns the changes for the client."
  @spec refresh(t()) :: {[action()], t()}
  def refresh(view), do: finish(view, :push)

  defp handle_params(%{socket: socket, route: route, uri: uri} = view, params) do
    with {:cont, socket} <- Lifecycle.run(socket, :handle_params, [params, URI.to_string(uri)]),
         true <- function_exported?(route.view, :handle_params, 3) || {:none, socket},
         {:noreply, %Socket{} = socket} <- route.view.handle_params(params, URI.to_string(uri), socket) do
      %{view | socket: socket}
    else
      {:halt, socket} -> %{view | socket: socket}
      {:none, socket} -> %{view | socket: socket}
    end
  end

  # Follows the patches that the view requests; returns the messages for the client, newest first.
  defp patches(%{socket: %{redirected: {:patch, _}}}, done) when length(done) >= @max_patches,
    do: raise(ArgumentError, "the view patched itself #{@max_patches} times in a row")

  defp patches(%{socket: %{redirected: {:patch, %{to: to, kind: kind}}} = socket} = view, done) do
    uri = URI.merge(%{view.uri | query: nil, fragment: nil}, to)

    case Router.match(view.server.router, uri.path || "/") do
      {:ok, %{view: module} = route} when module == view.route.view ->
        view = %{view | socket: %{socket | redirected: nil}, route: route, uri: uri}
        view = handle_params(view, params(route, uri))
        patches(view, [%{kind: kind, to: to} | done])

      _other ->
        raise ArgumentError,
              "push_patch to #{to}, which is not a path of #{inspect(view.route.view)}: use redirect"
    end
  end

  defp patches(view, done), do: {view, done}

  defp finish(view, how) do
    {view, patches} = patches(view, [])
    pushed = patches |> Enum.reverse() |> Enum.map(&{:push, "live_patch", &1})

    case view.socket.redirected do
      nil -> rendered(view, how, pushed)
      {:redirect, target} -> {pushed ++ leave(view, how, target), view}
    end
  end

  defp rendered(view, how, pushed) do
    {diff, view} = diff(view)

    actions =
      case {how, diff} do
        {:reply, diff} when diff == %{} -> [{:reply, %{}}]
        {:reply, diff} -> [{:reply, %{diff: diff}}]
        {:push, diff} when diff == %{} -> []
        {:push, diff} -> [{:push, "diff", diff}]
      end

    {pushed ++ actions, view}
  end

  # Nothing is rendered if no assign has changed.
  defp diff(%{socket: socket} = view) do
    if socket.assigns.__changed__ == %{} do
      {extras(%{}, view), settle(view, nil)}
    else
      rendered = render(view)
      {view.sent |> Diff.diff(rendered) |> extras(view), settle(view, rendered)}
    end
  end

  defp extras(wire, %{socket: socket}) do
    wire = if title?(socket.assigns), do: Map.put(wire, :t, to_string(socket.assigns.page_title)), else: wire

    case socket.private[:push_events] do
      events when events in [nil, []] -> wire
      events -> Map.put(wire, :e, Enum.reverse(events))
    end
  end

  defp title?(%{__changed__: changed, page_title: title}),
    do: title != nil and is_map_key(changed, :page_title)

  defp title?(_assigns), do: false

  # Sent changes are cleared.
  defp settle(%{socket: socket} = view, rendered) do
    socket = %{
      socket
      | assigns: %{socket.assigns | __changed__: %{}},
        private: Map.delete(socket.private, :push_events)
    }

    %{view | socket: socket, sent: rendered || view.sent}
  end

  defp leave(view, how, target) do
    payload = elsewhere(view.server, target, view.socket.assigns.flash)
    events = view.socket.private[:push_events]
    before = if events in [nil, []], do: [], else: [{:push, "diff", %{e: Enum.reverse(events)}}]

    case how do
      :reply -> before ++ [{:reply, %{redirect: payload}}, :stop]
      :push -> before ++ [{:push, "redirect", payload}, :stop]
    end
  end

  @doc "Where a view redirects to, as the client gets it, with the flash to carry."
  @spec elsewhere(Server.t(), %{to: String.t()}, map()) :: map()
  def elsewhere(_server, target, flash) when flash == %{}, do: target
  def elsewhere(server, target, flash), do: Map.put(target, :flash, Token.sign(server.secret, "flash", flash))

  defp params(route, uri) do
    case Query.decode(uri.query || "") do
      {:ok, params} -> Map.merge(params, route.params)
      {:error, _words} -> route.params
    end
  end
end
