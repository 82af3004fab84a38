defmodule FleetWeb.Console.Access.Session do
  @moduledoc """
  The signed cookie's statement of who is signed in, and who that is now. Pure, except for looking a user up.

  A session belongs either to a user (`"user"`, and `"stamp"`, which a new password invalidates), or to the address that `bin/run`
  prints (`"launch"`, the unix time of the click): an admin, for a day.
  """

  alias Aerie.Names
  alias Aerie.Policy.Roles
  alias FleetWeb.Console.Access.Users
  alias Phoenix.LiveView.Cookie

  @launch_s 24 * 3600
  @themes ~w(dark light)
  @theme_cookie "aerie_theme"

  @doc "The name of the cookie. Cookies ignore ports, so two gateways on one machine need different names."
  @spec cookie(secret :: binary()) :: String.t()
  def cookie(secret) do
    <<short::binary-4, _rest::binary>> = :crypto.hash(:sha256, ["cookie name: ", secret])
    "aerie_" <> Base.encode16(short, case: :lower)
  end

  @doc "What a page learns from a request besides the signed session: the theme."
  @spec extra(:cowboy_req.req()) :: %{String.t() => String.t()}
  def extra(request) do
    case List.keyfind(Cookie.cookies(request), @theme_cookie, 0) do
      {_name, theme} when theme in @themes -> %{"theme" => theme}
      _other -> %{}
    end
  end

  @doc "The session of a user who has signed in."
  @spec of_user(Users.user()) :: map()
  def of_user(user), do: %{"user" => user.name, "stamp" => stamp(user)}

  @doc "The session of the printed address."
  @spec of_launch() :: map()
  def of_launch, do: %{"launch" => System.system_time(:second)}

  @doc "The signed-in user, or nil."
  @spec user(Names.gateway(), map(), now :: integer()) :: Roles.source() | nil
  def user(gateway, session, now \\ System.system_time(:second))

  def user(gateway, %{"user" => name, "stamp" => stamp}, _now) do
    case Users.find(gateway, name) do
      %{role: role} = user -> if stamp(user) == stamp, do: source(name, role)
      nil -> nil
    end
  end

  def user(_gateway, %{"launch" => at}, now) when now - at < @launch_s, do: source("local", :admin)
  def user(_gateway, _session, _now), do: nil

  defp source(name, role), do: %{name: name, role: role, permissions: []}

  defp stamp(%{password: stored}) do
    <<stamp::binary-9, _rest::binary>> = :crypto.hash(:sha256, ["session: ", stored])
    Base.url_encode64(stamp)
  end
end
