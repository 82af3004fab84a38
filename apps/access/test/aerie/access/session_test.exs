defmodule Aerie.Access.SessionTest do
  @moduledoc "Whom a cookie's session stands for, and when it no longer does."
  use ExUnit.Case, async: true

  alias Aerie.Access.{Session, Sessions, Users}
  alias Aerie.Access.Users.Password
  alias Aerie.Base.{Principal, PubSub}

  @moduletag :tmp_dir
  @stored Password.hash("the-right-password", 1_000)

  setup %{tmp_dir: dir} do
    gateway = make_ref()
    start_supervised!({PubSub, gateway: gateway})
    file = Users.file(dir)

    users =
      for {name, role} <- [ann: "operator", bob: "admin"], do: %{name: name, role: role, password: @stored}

    File.write!(file, JSON.encode!(%{users: users}))
    File.chmod!(file, 0o600)
    start_supervised!({Users, gateway: gateway, file: file})
    start_supervised!({Sessions, gateway: gateway, file: Path.join(dir, "sessions.json")})
    %{gateway: gateway}
  end

  defp signed_in(gateway, name), do: Session.of_user(gateway, Users.find(gateway, name))

  test "a user's session is the user with role and permissions, for a month", %{gateway: gateway} do
    :ok = Users.set_permissions(gateway, "ann", ["receiver"])
    session = signed_in(gateway, "ann")

    assert %Principal{kind: :user, name: "ann", role: :operator, permissions: [:receiver]} =
             user = Session.user(gateway, session)

    assert Principal.may?(user, :receiver) and Principal.may?(user, :fly)
    refute Principal.may?(user, :terminate)

    now = System.system_time(:second)
    assert Session.user(gateway, session, now + 29 * 24 * 3600) == user
    assert Session.user(gateway, session, now + 31 * 24 * 3600) == nil
  end

  test "the printed address is an admin, for a day", %{gateway: gateway} do
    session = Session.of_launch(gateway)
    assert %Principal{kind: :user, name: "local", role: :admin} = Session.user(gateway, session)
    assert Session.user(gateway, session, System.system_time(:second) + 25 * 3600) == nil
    :ok = Sessions.finish(gateway, session["id"])
    assert Session.user(gateway, session) == nil
  end

  test "another role, password or permission ends the session, even before it is removed", %{gateway: gateway} do
    session = signed_in(gateway, "ann")

    for stamp <- ["", nil, signed_in(gateway, "bob")["stamp"]],
        do: assert(Session.user(gateway, %{session | "stamp" => stamp}) == nil)

    for change <- [
          &Users.set_role(&1, "ann", "pilot"),
          &Users.set_permissions(&1, "ann", ["terminate"]),
          &Users.remove(&1, "ann")
        ] do
      session = signed_in(gateway, "ann")
      assert Session.user(gateway, session) != nil
      :ok = change.(gateway)
      assert Session.user(gateway, session) == nil
    end
  end

  test "nobody's session is a way in as somebody else", %{gateway: gateway} do
    mine = signed_in(gateway, "ann")
    theirs = signed_in(gateway, "bob")
    launch = Session.of_launch(gateway)

    for forged <- [
          %{"id" => mine["id"], "launch" => true},
          %{"id" => mine["id"], "user" => "bob"},
          %{theirs | "id" => mine["id"]},
          %{theirs | "id" => launch["id"]},
          %{launch | "id" => mine["id"]},
          Map.delete(mine, "id"),
          %{mine | "id" => 7},
          %{mine | "id" => "another"},
          %{}
        ],
        do: assert(Session.user(gateway, forged) == nil)

    assert Session.user(make_ref(), mine) == nil
  end

  test "a user has twenty sessions, and a new one ends the oldest", %{gateway: gateway} do
    other = signed_in(gateway, "bob")
    sessions = for _n <- 1..21, do: signed_in(gateway, "ann")
    assert Enum.count(sessions, &(Session.user(gateway, &1) != nil)) == 20
    assert Session.user(gateway, List.last(sessions)) != nil
    assert %{name: "bob"} = Session.user(gateway, other)
  end

  test "gateways of one machine have cookies of different names; the theme is one of two" do
    assert "aerie_" <> <<_::binary-8>> = name = Session.cookie("a secret")
    assert Session.cookie("a secret") == name
    assert Session.cookie("another") != name

    for {cookie, extra} <- [{"aerie_theme=dark", %{"theme" => "dark"}}, {"aerie_theme=pink", %{}}, {"", %{}}],
        do: assert(Session.extra(%{headers: %{"cookie" => cookie}}) == extra)
  end
end
