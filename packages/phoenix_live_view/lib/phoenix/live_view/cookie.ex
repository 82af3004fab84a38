defmodule Phoenix.LiveView.Cookie do
  @moduledoc """
  The session cookie: a signed map with a CSRF token in it. HttpOnly, SameSite=Lax, and Secure under TLS. Its
  name is the server's `:cookie`: cookies ignore ports, so two servers on one host need different names.
  """

  alias Phoenix.LiveView.Token

  @max_age_s 30 * 24 * 3600

  @doc "The session of a request; `%{}` without a valid one."
  @spec read(:cowboy_req.req(), binary(), String.t()) :: map()
  def read(request, secret, name) do
    with {_name, value} <- List.keyfind(cookies(request), name, 0),
         {:ok, %{} = session} <- Token.verify(secret, "cookie", value, @max_age_s) do
      session
    else
      _none -> %{}
    end
  end

  @doc "The cookies of a request; an invalid header counts as none."
  @spec cookies(:cowboy_req.req()) :: [{binary(), binary()}]
  def cookies(request) do
    :cowboy_req.parse_cookies(request)
  catch
    _kind, _reason -> []
  end

  @doc "Sets the session of the answer."
  @spec write(:cowboy_req.req(), binary(), String.t(), map()) :: :cowboy_req.req()
  def write(request, secret, name, session) do
    :cowboy_req.set_resp_cookie(name, Token.sign(secret, "cookie", session), request, %{
      http_only: true,
      same_site: :lax,
      path: "/",
      max_age: @max_age_s,
      secure: :cowboy_req.scheme(request) == "https"
    })
  end

  @doc "The session with a CSRF token, which is added if it is missing."
  @spec with_csrf(map()) :: map()
  def with_csrf(%{"_csrf_token" => _} = session), do: session

  def with_csrf(session),
    do: Map.put(session, "_csrf_token", Base.url_encode64(:crypto.strong_rand_bytes(18), padding: false))

  @doc "Whether a request's CSRF token is the session's."
  @spec csrf?(map(), term()) :: boolean()
  def csrf?(%{"_csrf_token" => token}, given) when is_binary(given) and byte_size(given) == byte_size(token),
    do: :crypto.hash_equals(token, given)

  def csrf?(_session, _given), do: false
end
