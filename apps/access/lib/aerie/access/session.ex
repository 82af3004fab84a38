defmodule Aerie.Access.Session do
  @moduledoc """
  The signed cookie's statement of who is signed in, and who that is now.

  A session is open as long as its `"id"` is listed (`Aerie.Access.Sessions`). It belongs either to a user (`"user"`,
  and `"stamp"`, which another password, role or permission invalidates), for a month, or to the address that `bin/run`
  prints (`"launch"`): an admin, for a day.
  """

  alias Aerie.Access.{Principals, PrivateFile, Sessions, Users}
  alias Aerie.Base.{Names, Principal}
  alias Phoenix.LiveView.Cookie

  @launch_s 24 * 3600
  @user_s 30 * 24 * 3600
  @themes ~w(dark light)
  @theme_cookie "aerie_theme"

  @secret_bytes 32

  @doc "The secret that signs sessions: in a file of a folder, made if the file is missing, so that a restart ends no session."
  @spec secret(Names.gateway(), Path.t()) :: {:ok, binary()} | {:error, String.t()}
  def secret(gateway, dir) do
    path = Path.join(dir, "secret")

    case File.read(path) do
      {:ok, <<_::binary-size(@secret_bytes)>> = secret} -> {:ok, secret}
      {:error, :enoent} -> new_secret(path)
      _damaged -> another_secret(gateway, path)
    end
  end

  defp another_secret(gateway, path) do
    with {:ok, nil} <- PrivateFile.set_aside(gateway, path, "everybody has to sign in again", nil),
         do: new_secret(path)
  end

  defp new_secret(path) do
    secret = :crypto.strong_rand_bytes(@secret_bytes)
    with :ok <- PrivateFile.write(path, secret), do: {:ok, secret}
  end

  @doc "The name of the cookie. Cookies ignore ports, so two gateways on one machine need different names."
  @spec cookie(secret :: binary()) :: String.t()
  def cookie(secret) do
    <<short::binary-4, _rest::binary>> = :crypto.hash(:sha256, ["cookie name: ", secret])
    "aerie_" <> Base.encode16(short, case: :lower)
  end

  @doc "The part of a request, besides the signed session, that a page gets: the theme."
  @spec extra(:cowboy_req.req()) :: %{String.t() => String.t()}
  def extra(request) do
    case List.keyfind(Cookie.cookies(request), @theme_cookie, 0) do
      {_name, theme} when theme in @themes -> %{"theme" => theme}
      _other -> %{}
    end
  end

  @doc "Opens a session of a user who has signed in."
  @spec of_user(Names.gateway(), Users.user()) :: map()
  def of_user(gateway, user),
    do: %{"user" => user.name, "stamp" => stamp(user), "id" => Sessions.open(gateway, user.name, @user_s)}

  @doc "Opens a session of the printed address."
  @spec of_launch(Names.gateway()) :: map()
  def of_launch(gateway), do: %{"launch" => true, "id" => Sessions.open(gateway, nil, @launch_s)}

  @doc "The signed-in user, or nil."
  @spec user(Names.gateway(), map(), now :: integer()) :: Principal.t() | nil
  def user(gateway, session, now \\ System.system_time(:second)) do
    with {:ok, owner} <- Sessions.owner(gateway, session["id"], now),
         do: of(gateway, owner, session),
         else: (:error -> nil)
  end

  defp of(gateway, name, %{"user" => name, "stamp" => stamp}) when name != nil do
    case Users.find(gateway, name) do
      %{} = user -> if stamp(user) == stamp, do: Principals.of(user)
      nil -> nil
    end
  end

  defp of(_gateway, nil, %{"launch" => _signed}), do: Principals.of(:printed_address)
  defp of(_gateway, _owner, _session), do: nil

  defp stamp(%{password: stored, role: role, permissions: permissions}) do
    may = Enum.map_join([role | permissions], ",", &Atom.to_string/1)
    <<stamp::binary-9, _rest::binary>> = :crypto.hash(:sha256, ["session: ", may, " ", stored])

    Base.url_encode64(stamp)
  end
end
