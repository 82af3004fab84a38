defmodule Phoenix.LiveView.View.Static do
  @moduledoc """
  The page that answers a GET: the root layout around an element with the view's token and its first rendering.
  """

  alias Phoenix.LiveView.{Diff, Router, Server, Socket, Token, View}

  @typedoc """
  `:ok` with HTML, a redirect with the flash to carry, not found, or refused with the status (400 to 499) that the field
  `plug_status` of a raised exception names.
  """
  @type outcome :: {:ok, iodata()} | {:redirect, String.t(), map()} | :not_found | {:refused, 400..499}

  @doc "`info`: `:session` (string-keyed map), `:flash`, `:csrf_token` and further facts about the request."
  @spec render(Server.t(), URI.t(), map()) :: outcome()
  def render(%Server{} = server, uri, info) do
    with {:ok, route} <- Router.match(server.router, uri.path || "/") do
      id = "phx-" <> Base.url_encode64(:crypto.strong_rand_bytes(9), padding: false)
      socket = Socket.new(server, route, uri, info[:flash] || %{}, id: id, private: %{connect_info: info})

      case View.mount(%View{server: server, route: route, socket: socket}, uri, info[:session] || %{}) do
        {:ok, view} -> {:ok, page(server, view, info)}
        {:away, %{to: to}, view} -> {:redirect, to, view.socket.assigns.flash}
      end
    else
      :error -> :not_found
    end
  rescue
    error -> refused(error, __STACKTRACE__)
  end

  defp refused(%{plug_status: status}, _trace) when status in 400..499, do: {:refused, status}
  defp refused(error, trace), do: reraise(error, trace)

  defp page(server, %{socket: socket, route: route} = view, info) do
    content = {:safe, container(server, socket, route, View.render(view))}

    case server.root_layout do
      nil ->
        elem(content, 1)

      {module, name} ->
        assigns = %{
          __changed__: nil,
          inner_content: content,
          page_title: socket.assigns[:page_title],
          csrf_token: info[:csrf_token],
          flash: socket.assigns.flash
        }

        ["<!DOCTYPE html>\n", module |> apply(name, [Map.merge(socket.assigns, assigns)]) |> Diff.to_iodata()]
    end
  end

  defp container(server, socket, route, rendered) do
    token =
      Token.sign(server.secret, "session", %{
        id: socket.id,
        view: route.view,
        live_session: route.session.name,
        flash: socket.assigns.flash
      })

    [
      ["<div id=\"", socket.id, "\" data-phx-main data-phx-session=\"", token, "\" data-phx-static=\"\">"],
      [Diff.to_iodata(rendered), "</div>"]
    ]
  end
end
