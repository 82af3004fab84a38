defmodule Aerie.Access.ChangesTest do
  @moduledoc "No user and no key is changed without a record of who, from where, and what; no secret is in it."
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Access.{Changes, KeyRing, Users, WorkLimit}
  alias Aerie.Access.Changes.Rights
  alias Aerie.Control.Policy.Audit

  @moduletag :tmp_dir
  @by %{name: "console:admin", from: "192.0.2.7"}

  setup %{tmp_dir: dir} do
    gateway = make_ref()
    start_supervised!({WorkLimit, gateway: gateway})
    start_supervised!({Users, gateway: gateway, file: Users.file(dir)})
    start_supervised!({KeyRing, gateway: gateway, configured: [], file: Path.join(dir, "keys")})
    start_supervised!({Audit, gateway: gateway, dir: Path.join(dir, "audit"), max_bytes: 8_000_000})
    {:ok, gateway: gateway}
  end

  defp records(dir, type), do: for(%{"type" => ^type} = record <- Aerie.CommandCase.audit(dir), do: record)
  defp text(dir), do: dir |> Path.join("audit/*.jsonl") |> Path.wildcard() |> Enum.map_join(&File.read!/1)

  defp recorded(dir, type, n) do
    eventually(fn ->
      records = records(dir, type)
      if length(records) >= n, do: records
    end)
  end

  # A function that changes something comes here with its record, or the test fails.
  test "users: each change, who made it, from where, and no password", %{gateway: gateway, tmp_dir: dir} do
    changes = %{
      add: {fn -> Users.add(gateway, "ann", "viewer", "the-password-of-ann", @by) end, %{"role" => "viewer"}},
      set_role:
        {fn -> Users.set_role(gateway, "ann", "operator", @by) end,
         %{"role" => "operator", "before" => "viewer"}},
      set_permissions:
        {fn -> Users.set_permissions(gateway, "ann", ["receiver"], @by) end,
         %{"action" => "permissions", "permissions" => ["receiver"], "before" => []}},
      set_password:
        {fn -> Users.set_password(gateway, "ann", "another-password", @by) end, %{"action" => "password"}},
      remove: {fn -> Users.remove(gateway, "ann", @by) end, %{"action" => "remove", "before" => "operator"}}
    }

    reads =
      [:start_link, :list, :find, :check, :busy, :same, :name, :file, :read, :any?, :child_spec, :init] ++
        [:handle_call, :format_status, :code_change, :handle_cast, :handle_info, :terminate]

    assert names(Users) -- reads == Enum.sort(Map.keys(changes))

    for {name, n} <- Enum.with_index([:add, :set_role, :set_permissions, :set_password, :remove], 1) do
      {change, said} = changes[name]
      assert :ok = change.()
      record = dir |> recorded("user", n) |> List.last()
      assert %{"source" => "console:admin", "from" => "192.0.2.7", "user" => "ann"} = record
      assert Map.take(record, Map.keys(said)) == said
    end

    assert {:error, _none} = Users.remove(gateway, "ann", @by)
    assert length(records(dir, "user")) == 5
    refute text(dir) =~ "password-of-ann"
    refute text(dir) =~ "pbkdf2"
  end

  test "keys: each change, and not the key", %{gateway: gateway, tmp_dir: dir} do
    changes = [:make, :revoke]

    reads =
      [:start_link, :nobody, :admit, :list, :child_spec, :init, :handle_call, :code_change] ++
        [:handle_cast, :handle_info, :terminate]

    assert names(KeyRing) -- reads == changes
    {:ok, key} = KeyRing.make(gateway, "wall", "viewer", "2099-12-31", @by)
    :ok = KeyRing.revoke(gateway, "wall", @by)

    assert [
             %{"action" => "make", "key" => "wall", "role" => "viewer", "expires" => "2100-01-01" <> _},
             revoked
           ] =
             recorded(dir, "key", 2)

    assert %{"action" => "revoke", "source" => "console:admin", "from" => "192.0.2.7"} = revoked
    refute text(dir) =~ key
  end

  test "a page's change has the user and the address" do
    assert Changes.user(%{user: %{name: "ann"}, peer: {192, 0, 2, 7}}) == %{
             name: "console:ann",
             from: "192.0.2.7"
           }

    assert Changes.user(%{user: %{name: "ann"}}) == %{name: "console:ann", from: nil}
  end

  test "a request's record has what was changed, and no more of the answer than is of use", %{
    gateway: gateway,
    tmp_dir: dir
  } do
    :ok = Changes.request(gateway, @by, :add_link, nil, %{id: "radio", url: "udp:0.0.0.0:14550", more: 1})
    :ok = Changes.request(gateway, "aerie", :change_log, "link", %{level: :debug})
    :ok = Changes.request(gateway, "aerie", :change_rules, "gcs", %{rules: String.duplicate("x", 3_000)})
    assert [added, changed, long] = recorded(dir, "change", 3)
    assert %{"action" => "add_link", "target" => "radio", "from" => "192.0.2.7"} = added
    refute is_map_key(added, "now")
    assert %{"source" => "aerie", "target" => "link", "now" => %{"level" => "debug"}} = changed
    refute is_map_key(changed, "from") or is_map_key(long, "now")
  end

  test "a change that nobody listed needs an admin" do
    assert Rights.least(:command) == :operator
    assert Rights.least(:issue_ticket) == :viewer
    assert Rights.least(:a_new_one) == :admin
    assert Rights.all()[:make_key] == :admin
  end

  defp names(module),
    do: module.__info__(:functions) |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()
end
