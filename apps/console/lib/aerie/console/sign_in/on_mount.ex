defmodule Aerie.Console.SignIn.OnMount do
  @moduledoc """
  Checks before every page who is signed in and whether they may see it, and before each of its events whether they may cause it.

  Without a signed-in user it redirects to the sign-in page. If the session ends, because somebody signs out, the user
  is removed or gets another role, other permissions or another password, or its time is over, its pages end at once, and
  so does the WebSocket that carried them.

  What a user's pages do is paid for from the user's events (`Aerie.Access.WorkLimit.spend/3`): a page, a change of the address and what a page names as
  costly (`costly:` of `Aerie.Console`) cost more. When none are left, events are refused, and pages are answered with 429.
  """

  import Phoenix.Component
  import Phoenix.LiveView

  alias Aerie.Base.Names
  alias Aerie.Base.PubSub
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Session
  alias Aerie.Access.WorkLimit

  @page_cost 4
  @costly 5
  # A refusal is shown this seldom, because showing it is a rendering.
  @told_ms 2_000
  # Pages that end tell their browser where to go before its WebSocket is closed.
  @close_ms 1_000

  defmodule TooMany do
    @moduledoc "Too many pages and events of one user: answered with 429."
    defexception message: "too many pages and events of one user", plug_status: 429
  end

  @doc false
  def on_mount(:default, _params, session, socket) do
    gateway = session["gateway"]

    case Session.user(gateway, session) do
      nil ->
        {:halt, redirect(socket, to: "/sign-in")}

      user ->
        if WorkLimit.spend(gateway, user.name, @page_cost),
          do: admit(socket, gateway, user, session),
          else: raise(TooMany)
    end
  end

  defp admit(socket, gateway, user, session) do
    page = socket.view.__console__()

    if Roles.at_least?(user.role, page.role) do
      if connected?(socket), do: watch(gateway)

      {:cont,
       socket
       |> assign(
         gateway: gateway,
         user: user,
         peer: with(%{address: address} <- get_connect_info(socket, :peer_data), do: address),
         path: "/",
         connecting: unless(connected?(socket), do: clock()),
         theme: session["theme"],
         csrf_token: session["_csrf_token"]
       )
       |> attach_hook(:console_path, :handle_params, &path/3)
       |> attach_hook(:console_role, :handle_event, fn event, _value, socket ->
         event(page, event, session, socket)
       end)
       |> attach_hook(:console_users, :handle_info, fn message, socket ->
         handle_notice(message, session, socket)
       end)}
    else
      {:halt, socket |> put_flash(:error, "This page is for #{page.role}s.") |> redirect(to: "/")}
    end
  end

  # On a page that is not live yet: the age of its values.
  defp clock, do: Calendar.strftime(DateTime.utc_now(), "%H:%M:%S UTC")

  defp path(_params, uri, %{assigns: %{gateway: gateway, user: user}} = socket) do
    if WorkLimit.spend(gateway, user.name, @page_cost),
      do: {:cont, assign(socket, :path, URI.parse(uri).path || "/")},
      else: {:halt, socket}
  end

  # The user signed in now, not when the page was opened.
  defp event(page, event, session, %{assigns: %{user: user, gateway: gateway}} = socket) do
    least = Map.get(page.events, event, :operator)
    cost = if event in page.costly, do: @costly, else: 1

    cond do
      not WorkLimit.spend(gateway, user.name, cost) ->
        {:halt, flash(socket, "Too many clicks. Try again in 2 s.")}

      Session.user(gateway, session) != user ->
        {:halt, leave(socket)}

      Roles.at_least?(user.role, least) ->
        {:cont, socket}

      true ->
        {:halt, flash(socket, "#{String.capitalize("#{user.role}")}s can't do this. Ask an #{least}.")}
    end
  end

  defp flash(socket, words) do
    now = System.monotonic_time(:millisecond)
    told = socket.private[:console_told]

    if told == nil or now - told >= @told_ms,
      do: socket |> put_private(:console_told, now) |> put_flash(:error, words),
      else: socket
  end

  @doc "Tells this process when sessions end (`over?/3`)."
  @spec watch(Names.gateway()) :: :ok
  def watch(gateway) do
    :ok = PubSub.subscribe(gateway, {:notice, :console_users})
    :ok = PubSub.subscribe(gateway, {:notice, :console_sessions})
  end

  @doc "Whether a message to a WebSocket means that its session is over: in how many milliseconds it is closed."
  @spec over?(Names.gateway(), message :: term(), session :: map()) :: {:close, pos_integer()} | false
  def over?(gateway, {:fleet, {:notice, notice}, _who}, session)
      when notice in [:console_users, :console_sessions],
      do: if(Session.user(gateway, session) == nil, do: {:close, @close_ms}, else: false)

  def over?(_gateway, _message, _session), do: false

  defp handle_notice({:fleet, {:notice, notice}, _who}, session, %{assigns: %{user: user}} = socket)
       when notice in [:console_users, :console_sessions] do
    if Session.user(socket.assigns.gateway, session) == user,
      do: {:halt, socket},
      else: {:halt, leave(socket)}
  end

  defp handle_notice(_message, _session, socket), do: {:cont, socket}

  # User and session are notified one after the other, and the first notice already leads away.
  defp leave(%{redirected: nil} = socket), do: redirect(socket, to: socket.assigns.path)
  defp leave(socket), do: socket
end
