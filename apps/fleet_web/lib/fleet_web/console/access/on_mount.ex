defmodule FleetWeb.Console.Access.OnMount do
  @moduledoc """
  Checks before every page who is signed in and whether they may see it, and before each of its events whether they may cause it.

  Without a signed-in user it redirects to the sign-in page. If the user is removed, or gets another role or password, the page ends at once.
  """

  import Phoenix.Component
  import Phoenix.LiveView

  alias Aerie.Store.PubSub
  alias FleetWeb.Console.Access.{Role, Session}

  @doc false
  def on_mount(:default, _params, session, socket) do
    gateway = session["gateway"]

    case Session.user(gateway, session) do
      nil -> {:halt, redirect(socket, to: "/sign-in")}
      user -> admit(socket, gateway, user, session)
    end
  end

  defp admit(socket, gateway, user, session) do
    page = socket.view.__console__()

    if Role.at_least?(user.role, page.role) do
      if connected?(socket), do: PubSub.subscribe(gateway, {:notice, :console_users})

      {:cont,
       socket
       |> assign(
         gateway: gateway,
         user: user,
         path: "/",
         theme: session["theme"],
         csrf_token: session["_csrf_token"]
       )
       |> attach_hook(:console_path, :handle_params, &path/3)
       |> attach_hook(:console_role, :handle_event, fn event, _value, socket -> event(page, event, socket) end)
       |> attach_hook(:console_users, :handle_info, fn message, socket -> told(message, session, socket) end)}
    else
      {:halt, socket |> put_flash(:error, "This page is for #{page.role}s.") |> redirect(to: "/")}
    end
  end

  defp path(_params, uri, socket), do: {:cont, assign(socket, :path, URI.parse(uri).path || "/")}

  defp event(page, event, %{assigns: %{user: user}} = socket) do
    least = Map.get(page.events, event, :operator)

    if Role.at_least?(user.role, least),
      do: {:cont, socket},
      else:
        {:halt, put_flash(socket, :error, "As #{user.role} you may not do this: it needs the role #{least}.")}
  end

  defp told(
         {:fleet, {:notice, :console_users}, name},
         session,
         %{assigns: %{user: %{name: name} = user}} = socket
       ) do
    if Session.user(socket.assigns.gateway, session) == user,
      do: {:halt, socket},
      else: {:halt, redirect(socket, to: socket.assigns.path)}
  end

  defp told({:fleet, {:notice, :console_users}, _other}, _session, socket), do: {:halt, socket}
  defp told(_message, _session, socket), do: {:cont, socket}
end
