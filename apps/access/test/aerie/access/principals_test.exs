defmodule Aerie.Access.PrincipalsTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.Principals
  alias Aerie.Base.Principal
  alias Aerie.Control.Policy.Roles

  @key %{name: "k", digest: <<1::256>>, role: nil, permissions: [], until: nil}
  @user %{name: "ann", role: :operator, permissions: [:receiver], password: "pbkdf2-sha256$…"}

  test "a user, a key and the printed address are principals with all that they may do" do
    for {shown, kind, name, role} <- [
          {@user, :user, "ann", :operator},
          {%{@key | role: :viewer}, :key, "k", :viewer},
          {%{@key | role: :pilot, permissions: [:terminate]}, :key, "k", :pilot},
          {:printed_address, :user, "local", :admin},
          {:program, :client, "local", :viewer}
        ] do
      assert %Principal{kind: ^kind, name: ^name, role: ^role} = principal = Principals.of(shown)
      assert principal.may == Roles.may(principal)
      assert Principals.commanding(principal) == principal
    end

    assert Principal.may?(Principals.of(@user), :receiver)
    refute Principal.may?(Principals.of(%{@key | role: :operator}), :receiver)
    # Neither the key nor the password goes along.
    refute inspect(Principals.of(@user), limit: :infinity) =~ "pbkdf2"
    refute is_map_key(Principals.of(@key), :digest)
  end

  test "a key without a role is an admin over /api; a WebSocket still sees that it has none" do
    key = Principals.of(%{@key | permissions: [:terminate]})
    assert %Principal{role: nil, permissions: [:terminate]} = key
    assert Principals.role(key) == :admin
    assert Principals.commanding(key) == Roles.principal(:key, "k", :admin, [:terminate])
  end

  test "a program of this machine changes the gateway as an operator, and commands nothing" do
    program = Principals.of(:program)
    assert Principals.role(program) == :operator
    assert program.may == []
    # A key that happens to have its name is not taken for it.
    assert Principals.role(Principals.of(%{@key | name: "local", role: :viewer})) == :viewer
  end
end
