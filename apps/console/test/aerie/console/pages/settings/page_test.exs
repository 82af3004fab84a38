defmodule Aerie.Console.Pages.Settings.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Base.Secret
  alias Aerie.Access.Users

  setup do: {:ok, start_console()}

  test "an admin adds a user, gives roles and passwords, and removes", %{console: console} do
    {:ok, view, html} = live(conn(console, :admin), "/settings")
    assert html =~ "operator"

    fields = %{"name" => "ann", "role" => "viewer", "password" => "a-password-of-ann"}
    assert view |> form("#add-user", fields) |> render_submit() =~ "User added. They can sign in now."
    assert {:ok, %{role: :viewer}} = Users.check(console.gateway, "ann", "a-password-of-ann", {:name, "test"})

    view |> form("#role-ann", %{"role" => "operator"}) |> render_change()
    assert Users.find(console.gateway, "ann").role == :operator

    view |> element("#user-ann button", "Password") |> render_click()
    view |> form("#change-password", %{"password" => "another-of-ann"}) |> render_submit()
    assert {:ok, _user} = Users.check(console.gateway, "ann", "another-of-ann", {:name, "test"})

    view |> element("#user-ann button", "Remove") |> render_click()
    assert view |> element("#remove-user button.danger") |> render_click() =~ "User removed"
    assert Users.find(console.gateway, "ann") == nil
  end

  test "an admin gives permissions beyond a role: at once, and only those", %{console: console} do
    {:ok, operators, _html} = live(conn(console, :operator), "/")
    {:ok, view, _html} = live(conn(console, :admin), "/settings")
    view |> element("#user-operator button", "Permissions") |> render_click()
    # What the role includes is not offered.
    assert has_element?(view, "#permission-receiver")
    refute has_element?(view, "#permission-arm")

    assert view |> form("#change-permissions", %{"permission-receiver" => "true"}) |> render_submit() =~
             "Permissions changed."

    assert %{permissions: [:receiver]} = Users.find(console.gateway, "operator")
    assert has_element?(view, "#user-operator .user-permissions", "receiver")
    # An open page has the old ones, so it ends.
    assert_redirect(operators, "/")

    assert {:ok, [_admin, %{name: "operator", permissions: [:receiver]}, _viewer]} =
             Users.read(Users.file(console.dir))

    # It is exactly what was ticked.
    view |> element("#user-operator button", "Permissions") |> render_click()
    assert has_element?(view, "#permission-receiver[checked]")

    view
    |> form("#change-permissions", %{"permission-receiver" => "false", "permission-motors" => "true"})
    |> render_submit()

    assert %{permissions: [:motors]} = Users.find(console.gateway, "operator")

    # Another role keeps what it does not include; a viewer has none, and is offered none.
    assert :ok = Users.set_permissions(console.gateway, "operator", ~w(motors protection))
    assert :ok = Users.set_role(console.gateway, "operator", "admin")
    assert %{role: :admin, permissions: [:motors]} = Users.find(console.gateway, "operator")
    assert :ok = Users.set_role(console.gateway, "operator", "viewer")
    assert %{role: :viewer, permissions: []} = Users.find(console.gateway, "operator")
    {:ok, view, _html} = live(conn(console, :admin), "/settings")
    refute has_element?(view, "#user-operator button", "Permissions")
  end

  test "what no role lacks, or nobody knows, is refused as a permission", %{console: console} do
    for {name, names, words} <- [
          {"operator", ["arm"], "beyond the role operator"},
          {"operator", ["everything"], "beyond the role operator"},
          {"operator", "receiver", "a list of permissions"},
          {"viewer", ["receiver"], "give another role first"},
          {"nobody", ["receiver"], "no such user"}
        ] do
      assert {:error, text} = Users.set_permissions(console.gateway, name, names)
      assert text =~ words
    end

    assert [[], [], []] = Enum.map(Users.list(console.gateway), & &1.permissions)
  end

  test "what is wrong is said beside the form, and nothing changes", %{console: console} do
    {:ok, view, _html} = live(conn(console, :admin), "/settings")
    fields = %{"name" => "ann", "role" => "viewer", "password" => "short"}
    assert view |> form("#add-user", fields) |> render_submit() =~ "10 characters or more"
    assert render_click(view, "add", %{"name" => "x"}) =~ "Fill in role and password."
    assert length(Users.list(console.gateway)) == 3
  end

  test "others see no users, cannot change any, but their own password", %{console: console} do
    {:ok, view, html} = live(conn(console, :operator), "/settings")
    refute html =~ "Add a user"

    for {event, value} <- [
          {"add", %{"name" => "eve", "role" => "admin", "password" => "a-password-of-eve"}},
          {"change-role", %{"name" => "operator", "role" => "admin"}},
          {"change-permissions", %{"name" => "operator", "permission-receiver" => "true"}},
          {"change-password", %{"name" => "admin", "password" => "a-password-of-eve"}},
          {"remove", %{"name" => "admin"}}
        ],
        do: assert(render_click(view, event, value) =~ "Ask an admin.")

    assert Enum.map(Users.list(console.gateway), & &1.role) == [:admin, :operator, :viewer]

    own = %{"old" => "wrong-password", "new" => "my-new-password", "again" => "my-new-password"}
    assert view |> form("#own-password", own) |> render_submit() =~ "the old password is wrong"
    own = %{own | "old" => password(:operator), "again" => "another-password"}
    assert view |> form("#own-password", own) |> render_submit() =~ "the two new passwords differ"
    own = %{own | "again" => "my-new-password"}
    # It ends all sessions, this one too.
    view |> form("#own-password", own) |> render_submit()
    assert_redirect(view, "/settings")
    assert {:ok, _user} = Users.check(console.gateway, "operator", "my-new-password", {:name, "test"})
  end

  test "a key is made, shown once, opens what its role may, and is revoked", %{console: console} do
    admin = conn(console, :admin)
    {:ok, view, _html} = live(admin, "/settings")
    assert status(console, nil) == 200

    view
    |> form("#add-key", %{"name" => "wall", "role" => "viewer", "expires" => "2099-12-31"})
    |> render_submit()

    [_all, text] = Regex.run(~r/id="new-key-text"[^>]*>([^<]+)</, render(view))
    assert status(console, text) == 200
    # There is a key now, so this machine needs one too.
    assert status(console, nil) == 401
    assert status(console, "x" <> text) == 401

    {:ok, again, html} = live(admin, "/settings")
    assert html =~ "2099-12-31"
    refute html =~ text
    refute File.read!(Path.join(console.dir, "keys")) =~ text
    refute view |> element("#new-key button") |> render_click() =~ text

    again |> element("#keys button", "Revoke") |> render_click()

    assert again |> element("#revoke-key button.danger") |> render_click() =~
             "Key revoked."

    assert status(console, text) == 200
    refute has_element?(again, "#keys")
  end

  test "what is wrong about a key is said, and nothing of it is written", %{console: console} do
    {:ok, view, _html} = live(conn(console, :admin), "/settings")

    for {fields, words} <- [
          {%{"name" => "a b"}, "a name has 1 to 32 characters"},
          {%{"name" => "local"}, "programs of this machine"},
          {%{"role" => "king"}, "role= expects"},
          {%{"role" => "viewer permissions=force_disarm"}, "expected a role"},
          {%{"expires" => "2020-01-01"}, "that day is over"},
          {%{"expires" => "soon"}, "expires= expects a day"}
        ] do
      form = Map.merge(%{"name" => "wall", "role" => "viewer", "expires" => ""}, fields)
      assert render_hook(view, "add-key", form) =~ words
    end

    refute File.exists?(Path.join(console.dir, "keys"))
    {:ok, operator, _html} = live(conn(console, :operator), "/settings")
    form = %{"name" => "eve", "role" => "admin", "expires" => ""}
    assert render_click(operator, "add-key", form) =~ "Ask an admin."
    assert render_click(operator, "revoke-key", %{"name" => "wall"}) =~ "Ask an admin."
  end

  defp status(console, key) do
    headers = if key, do: [{"x-aerie-key", key}], else: []
    {status, _headers, _body} = Aerie.APICase.request(console.port, "GET", "/api/status", headers)
    status
  end

  test "the configuration, for admins only, found by words and by what was set" do
    key = %{
      value: "4711",
      default: "4000",
      source: "aerie.yaml",
      unit: nil,
      expected: "an integer",
      meaning: "Port."
    }

    keys = [
      Map.put(key, :path, "http.port"),
      Map.merge(key, %{path: "http.hosts", source: nil, value: "4000"})
    ]

    section = %{name: "http", meaning: "The console.", keys: keys}
    [console: console] = start_console(configuration: fn -> [section] end)

    {:ok, view, _html} = live(conn(console, :admin), "/settings?part=configuration")
    assert has_element?(view, "[id='key-http.port']", "aerie.yaml")
    assert has_element?(view, "[id='key-http.hosts']", "default")
    view |> form("#configuration-filter", %{search: "port", given: "true"}) |> render_change()
    refute has_element?(view, "[id='key-http.hosts']")

    assert view |> form("#configuration-filter", %{search: "nothing like it"}) |> render_change() =~
             "No match"

    {:ok, _view, html} = live(conn(console, :operator), "/settings?part=configuration")
    refute html =~ "aerie.yaml"
  end

  test "keys of programs are listed, without what would help to use one" do
    [console: console] = start_console(config: %{api: %{key: Secret.new("a-key-that-is-secret")}})
    {:ok, _view, html} = live(conn(console, :admin), "/settings")
    assert html =~ "api.key"
    refute html =~ "a-key-that-is-secret"
  end
end
