defmodule Phoenix.LiveView.Cowboy.Page do
  @moduledoc false
  # Answers GET of a page. The page contains tokens, so it must not be cached.
  @behaviour :cowboy_handler

  alias Phoenix.LiveView.{Cookie, Cowboy, Token}
  alias Phoenix.LiveView.View.Static

  # The client writes both.
  @flash_cookie "__phoenix_flash__"
  @status_cookie "__phoenix_reload_status__"

  @impl :cowboy_handler
  def init(request, server) do
    if :cowboy_req.method(request) in ["GET", "HEAD"],
      do: page(request, server),
      else: {:ok, :cowboy_req.reply(405, %{"allow" => "GET, HEAD"}, "method not allowed\n", request), server}
  end

  defp page(request, server) do
    cookie = Cookie.read(request, server.secret, server.cookie)
    session = Cookie.with_csrf(cookie)

    request =
      if session == cookie, do: request, else: Cookie.write(request, server.secret, server.cookie, session)

    info = %{
      session: Map.merge(session, server.session.(request)),
      csrf_token: session["_csrf_token"],
      flash: flash(request, server),
      peer_data: peer(request)
    }

    headers = %{
      "content-type" => "text/html; charset=utf-8",
      "cache-control" => "no-store",
      "content-security-policy" => server.csp,
      "referrer-policy" => "same-origin",
      "x-content-type-options" => "nosniff",
      "x-frame-options" => "DENY"
    }

    outcome =
      case told(request, server) do
        nil -> Static.render(server, Cowboy.uri(request), info)
        status -> {:refused, status}
      end

    case outcome do
      {:ok, html} ->
        request = :cowboy_req.set_resp_cookie(@flash_cookie, "", request, %{max_age: 0, path: "/"})
        {:ok, :cowboy_req.reply(200, headers, html, request), server}

      {:redirect, to, flash} ->
        request = carried(request, server, flash)
        {:ok, :cowboy_req.reply(302, Map.put(headers, "location", to), "", request), server}

      :not_found ->
        {:ok, :cowboy_req.reply(404, headers, not_found(server), request), server}

      # Used once: the page's next request is a new one.
      {:refused, status} ->
        request = :cowboy_req.set_resp_cookie(@status_cookie, "", request, %{max_age: 0, path: "/"})
        {:ok, :cowboy_req.reply(status, headers, refused(status, server), request), server}
    end
  end

  # The status of a refused join, after which the client loads the page.
  defp told(request, server) do
    with {_name, token} <- List.keyfind(Cookie.cookies(request), @status_cookie, 0),
         {:ok, status} when status in 400..499 <- Token.verify(server.secret, "reload", token, 60) do
      status
    else
      _none -> nil
    end
  end

  defp refused(429, %{too_many: page}) when page != nil, do: page
  defp refused(_status, server), do: not_found(server)

  defp not_found(%{not_found: nil}),
    do: "<!DOCTYPE html>\n<title>Not found</title><p>There is no such page.</p>\n"

  defp not_found(%{not_found: page}), do: page

  defp flash(request, server) do
    with {_name, token} <- List.keyfind(Cookie.cookies(request), @flash_cookie, 0),
         {:ok, flash} when is_map(flash) <- Token.verify(server.secret, "flash", token, 60) do
      flash
    else
      _none -> %{}
    end
  end

  defp carried(request, _server, flash) when flash == %{}, do: request

  defp carried(request, server, flash),
    do:
      :cowboy_req.set_resp_cookie(@flash_cookie, Token.sign(server.secret, "flash", flash), request, %{
        max_age: 60,
        path: "/"
      })

  @doc false
  def peer(request) do
    {address, port} = :cowboy_req.peer(request)
    %{address: address, port: port}
  end
end
