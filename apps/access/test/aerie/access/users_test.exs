defmodule Aerie.Access.UsersTest do
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.{Users, WorkLimit}
  alias Aerie.Access.Users.Password

  @moduletag :tmp_dir

  defp users(dir, text, mode \\ 0o600) do
    file = Users.file(dir)
    File.write!(file, text)
    File.chmod!(file, mode)
    Users.read(file)
  end

  defp start(dir) do
    gateway = make_ref()
    start_supervised!({WorkLimit, gateway: gateway})
    start_supervised!({Users, gateway: gateway, file: Users.file(dir)})
    gateway
  end

  @stored Password.hash("the-right-password", 1_000)

  test "a password is known by its hash alone, and nothing else is taken for it" do
    assert Password.match?("the-right-password", @stored)
    refute @stored =~ "right"
    assert Password.hash("the-right-password", 1_000) != @stored

    for other <- ["the-right-passwor", "the-right-password ", "", nil, 7, String.duplicate("x", 10_000)],
        do: refute(Password.match?(other, @stored))

    for bad <- ["", "pbkdf2-sha256$1$a$b", "pbkdf2-sha256$99999999999$AAAA$AAAA", "md5$x", nil],
        do: refute(Password.stored?(bad))
  end

  test "a new password has a length, and is text" do
    assert :ok = Password.check("long-enough")

    for bad <- ["short", String.duplicate("x", 201), <<255, 254, 1, 2, 3, 4, 5, 6, 7, 8>>, nil],
        do: assert({:error, _} = Password.check(bad))
  end

  test "roles stand in an order, and no other text is one" do
    assert Roles.at_least?(:admin, :operator) and Roles.at_least?(:operator, :operator)
    refute Roles.at_least?(:viewer, :operator)
    assert Roles.parse("admin") == {:ok, :admin}
    for bad <- ["root", "Admin", "", nil, 1], do: assert(Roles.parse(bad) == :error)
  end

  test "a file of users is read; what is wrong with it is said, without its text", %{tmp_dir: dir} do
    one = ~s({"users": [{"name": "ann", "role": "operator", "password": "#{@stored}"}]})
    assert {:ok, [%{name: "ann", role: :operator}]} = users(dir, one)
    assert {:ok, []} = Users.read(Path.join(dir, "none"))

    for {text, says} <- [
          {"", "expected JSON"},
          {"[]", "expected JSON"},
          {~s({"users": [1]}), "users[0]: expected name, role and password"},
          {String.replace(one, "operator", "boss"),
           "users[0]: expected the role viewer, operator, pilot, admin"},
          {String.replace(one, "ann", "Ann Lee"), "users[0]: a name has"},
          {String.replace(one, @stored, "secret-text"), "users[0].password: expected pbkdf2-sha256"},
          {~s({"users": [#{String.duplicate("1,", 40_000)}1]}), "larger than"}
        ] do
      assert {:error, error} = users(dir, text)
      assert error =~ says
      refute error =~ "secret-text"
    end

    assert {:error, error} = users(dir, one, 0o644)
    assert error =~ "chmod 600"
  end

  test "changes are on the disk for their owner only, and a restart finds them", %{tmp_dir: dir} do
    gateway = start(dir)
    assert :ok = Users.add(gateway, "ann", "viewer", "a-password-of-ann", "boss")

    assert {:error, "there already is a user ann"} =
             Users.add(gateway, "ann", "admin", "another-password", "boss")

    assert :ok = Users.set_role(gateway, "ann", "operator")
    assert {:error, "there is no such user"} = Users.set_role(gateway, "bob", "admin")
    assert {:error, "expected the role" <> _} = Users.set_role(gateway, "ann", "boss")
    assert {:error, "a name has" <> _} = Users.add(gateway, "../ann", "viewer", "a-password-of-ann", "boss")

    file = Users.file(dir)
    assert (File.stat!(file).mode &&& 0o777) == 0o600
    assert {:ok, [%{name: "ann", role: :operator}]} = Users.read(file)
    assert {:ok, %{name: "ann"}} = Users.check(gateway, "ann", "a-password-of-ann", {:name, "ann"})
    assert :error = Users.check(gateway, "ann", "a-password-of-bob", {:name, "ann"})
    stop_supervised!(Users)
    start_supervised!({Users, gateway: gateway, file: file})
    assert {:ok, %{name: "ann"}} = Users.check(gateway, "ann", "a-password-of-ann", {:name, "ann"})
    assert :ok = Users.remove(gateway, "ann")
    assert Users.list(gateway) == []
  end

  test "a change that cannot be written does not hold", %{tmp_dir: dir} do
    {:ok, [_ann]} = users(dir, ~s({"users": [{"name": "ann", "role": "viewer", "password": "#{@stored}"}]}))
    gateway = start(dir)
    File.mkdir!(Users.file(dir) <> ".new")
    assert {:error, error} = Users.set_role(gateway, "ann", "admin")
    assert error =~ "users.json"
    assert Users.find(gateway, "ann").role == :viewer
  end
end
