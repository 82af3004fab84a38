defmodule Aerie.Console.SignIn.Handler do
  @moduledoc """
  Signing in and out: `/sign-in`, `/sign-out`, and `/launch`, the target of the address that `bin/run` prints. These are plain requests without a
  live page, because only they can set the session's cookie.
  """

  @behaviour :cowboy_handler

  alias Aerie.Base.Store
  alias Aerie.Base.Net.Address
  alias Aerie.Access.Changes
  alias Aerie.Access.HTTP.{Admission, Request}
  alias Aerie.Access.{Launch, Limiter, Session, Sessions, Users}
  alias Aerie.Access.Limiter.Attempts
  alias Aerie.Console.SignIn.Page
  alias Phoenix.LiveView.{Cookie, Query}

  @max_body 4_096

  @impl :cowboy_handler
  def init(request, %{policy: policy, what: what} = state) do
    facts = Request.facts(request)

    request =
      with :ok <- Admission.host(policy, facts), :ok <- Admission.origin(policy, facts) do
        answer(what, :cowboy_req.method(request), request, facts, state)
      else
        {:error, error} -> text(request, error.status, error.message)
      end

    {:ok, request, state}
  end

  defp answer(:sign_in, method, request, _facts, state) when method in ["GET", "HEAD"],
    do: form(request, 200, nil, state)

  defp answer(:sign_in, "POST", request, facts, state) do
    case fields(request, state) do
      {:ok, fields, request} -> sign_in(request, fields, facts.peer, state)
      {:error, request} -> form(request, 400, "The form was too old. Please try again.", state)
    end
  end

  defp answer(:sign_out, "POST", request, facts, state) do
    case fields(request, state) do
      {:ok, _fields, request} ->
        session = Cookie.read(request, state.server.secret, state.server.cookie)
        user = Session.user(state.gateway, session)
        if user, do: record(state, :signed_out, user.name, facts.peer)
        Sessions.finish(state.gateway, session["id"])
        signed(request, %{}, "/sign-in", state)

      {:error, request} ->
        text(request, 400, "the form was too old; load the page again")
    end
  end

  # Forwarded, or from another machine: not the person who saw the printed address.
  defp answer(:launch, "GET", request, facts, state) do
    query = request |> :cowboy_req.parse_qs() |> Map.new()

    cond do
      not Address.loopback?(facts.peer) or facts.forwarded ->
        form(request, 403, "That address is for this machine only. Sign in here.", state)

      Launch.valid?(state.gateway, query["token"]) ->
        # Never limited: the token cannot be guessed, and this way in must be open while somebody tries passwords.
        record(state, :launched, "local", facts.peer)
        signed(request, Session.of_launch(state.gateway), "/", state)

      true ->
        record(state, :refused, nil, facts.peer)

        form(
          request,
          403,
          "That address is from an earlier start. Open the one that bin/run prints now.",
          state
        )
    end
  end

  defp answer(_what, _method, request, _facts, _state), do: text(request, 405, "method not allowed")

  defp sign_in(request, %{"name" => name, "password" => password}, peer, %{gateway: gateway} = state) do
    with {:ok, known?} <- Limiter.try(gateway, peer, name),
         {:ok, user} <- Users.check(gateway, name, password, {:place, Attempts.place(peer), known?}) do
      Limiter.outcome(gateway, peer, name, :right)
      record(state, :signed_in, user.name, peer)
      signed(request, Session.of_user(gateway, user), "/", state)
    else
      {:wait, seconds} ->
        record(state, :limited, known(gateway, name), peer)
        wait(request, seconds, "Too many attempts. Please wait #{seconds} seconds.", state)

      {:busy, seconds} ->
        Limiter.outcome(gateway, peer, name, :none)
        record(state, :limited, known(gateway, name), peer)

        wait(
          request,
          seconds,
          "Others are signing in just now. Please try again in #{seconds} seconds.",
          state
        )

      :error ->
        Limiter.outcome(gateway, peer, name, :wrong)
        record(state, :refused, known(gateway, name), peer)
        form(request, 403, "The name or the password is wrong.", state)
    end
  end

  defp sign_in(request, _no_fields, _peer, state),
    do: form(request, 400, "Name or password is missing.", state)

  defp wait(request, seconds, words, state) do
    request = :cowboy_req.set_resp_header("retry-after", "#{seconds}", request)
    form(request, 429, words, state)
  end

  # The CSRF token changes with every sign-in and sign-out.
  defp signed(request, session, to, %{server: server}) do
    request = Cookie.write(request, server.secret, server.cookie, Cookie.with_csrf(session))
    :cowboy_req.reply(303, Map.put(headers(server), "location", to), "", request)
  end

  defp form(request, status, message, %{gateway: gateway, server: server}) do
    session = Cookie.read(request, server.secret, server.cookie)
    kept = Cookie.with_csrf(session)
    request = if kept == session, do: request, else: Cookie.write(request, server.secret, server.cookie, kept)

    html =
      Page.html(%{
        gateway: gateway,
        csrf_token: kept["_csrf_token"],
        theme: Session.extra(request)["theme"],
        message: message,
        exposed: exposed(request),
        users?: Users.list(gateway) != []
      })

    :cowboy_req.reply(status, headers(server), html, request)
  end

  # The path of a password, if others can read it there.
  defp exposed(request) do
    facts = Request.facts(request)

    cond do
      :cowboy_req.scheme(request) == "https" ->
        nil

      Request.header(request, "x-forwarded-proto") == "https" ->
        "The gateway does not know the proxy that this page came by, so its cookie is not for TLS only. Add the proxy's address to http.proxies."

      Address.loopback?(facts.peer) and not facts.forwarded ->
        nil

      true ->
        "This connection has no TLS: what you type can be read on the way. Put a proxy with TLS in front (http.proxies)."
    end
  end

  defp fields(request, %{server: server}) do
    with {:ok, body, request} <- :cowboy_req.read_body(request, %{length: @max_body, period: 5_000}),
         {:ok, fields} <- Query.decode(body),
         session = Cookie.read(request, server.secret, server.cookie),
         true <- Cookie.csrf?(session, fields["_csrf_token"]) do
      {:ok, fields, request}
    else
      {:more, _body, request} -> {:error, request}
      _other -> {:error, request}
    end
  end

  defp headers(server) do
    %{
      "content-type" => "text/html; charset=utf-8",
      "cache-control" => "no-store",
      "content-security-policy" => server.csp,
      "referrer-policy" => "same-origin",
      "x-content-type-options" => "nosniff",
      "x-frame-options" => "DENY"
    }
  end

  defp text(request, status, words),
    do: :cowboy_req.reply(status, %{"content-type" => "text/plain; charset=utf-8"}, words <> "\n", request)

  # What is not a user's name may be a password.
  defp known(gateway, name), do: if(Users.find(gateway, name), do: name)

  defp record(%{gateway: gateway}, outcome, name, peer) do
    if outcome != :signed_out, do: Store.count_if_running(gateway, {:console, outcome})
    Changes.sign_in(gateway, outcome, "console", name, peer)
  end
end
