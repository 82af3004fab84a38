defmodule Aerie.Console.AccessTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Access.{Launch, Users}

  setup do: {:ok, start_console()}

  test "nobody sees a page without signing in, neither by GET nor by a join", %{console: console} do
    assert {:error, {:redirect, %{to: "/sign-in"}}} = live(conn(console, nil), "/")
    assert %{status: 302, headers: %{"location" => "/sign-in"}} = get(console, "/")
  end

  test "name and password sign in; the session lasts over requests, and signing out ends it", %{
    console: console
  } do
    page = get(console, "/sign-in")
    assert page.status == 200 and page.body =~ "Sign in"
    signed = sign_in(console, "operator", password(:operator))
    assert %{status: 303, headers: %{"location" => "/"}} = signed
    assert signed.cookie =~ "HttpOnly" and signed.cookie =~ "SameSite=Lax"
    home = get(console, "/", signed.jar)
    assert home.status == 200 and home.body =~ "operator"

    out = post(console, "/sign-out", home.jar, %{"_csrf_token" => csrf(home.body)})
    assert %{status: 303, headers: %{"location" => "/sign-in"}} = out
    assert get(console, "/", out.jar).status == 302
  end

  test "a wrong password and an unknown name are refused alike", %{console: console} do
    for {name, password} <- [{"operator", "not-the-password"}, {"nobody", "not-the-password"}, {"", ""}] do
      refused = sign_in(console, name, password)
      assert refused.status == 403
      assert refused.body =~ "The name or the password is wrong."
      assert get(console, "/", refused.jar).status == 302
    end
  end

  test "after five wrong tries even the right password has to wait", %{console: console} do
    for _try <- 1..5, do: assert(sign_in(console, "operator", "not-the-password").status == 403)
    limited = sign_in(console, "operator", password(:operator))
    assert limited.status == 429
    assert String.to_integer(limited.headers["retry-after"]) in 1..60
  end

  test "a form without the session's token is refused", %{console: console} do
    refused = post(console, "/sign-in", %{}, %{"name" => "operator", "password" => password(:operator)})
    assert refused.status == 400
    assert post(console, "/sign-out", sign_in(console, "admin", password(:admin)).jar, %{}).status == 400
  end

  test "a form of another site's page is refused", %{console: console} do
    page = get(console, "/sign-in")
    fields = %{"_csrf_token" => csrf(page.body), "name" => "admin", "password" => password(:admin)}
    assert post(console, "/sign-in", page.jar, fields, [{"origin", "https://evil.example"}]).status == 403
  end

  test "a foreign name that leads here gets nothing", %{console: console} do
    for path <- ["/", "/sign-in", "/launch"] do
      assert get(console, path, %{}, [{"host", "evil.example"}]).status == 403
    end
  end

  test "the printed address signs in as admin, by its token alone", %{console: console} do
    "http://" <> _rest = url = Launch.url(console.gateway, console.url)
    path = String.replace_prefix(url, console.url, "")
    launched = get(console, path)
    assert %{status: 303, headers: %{"location" => "/"}} = launched
    assert get(console, "/", launched.jar).body =~ "admin"

    assert get(console, "/launch?token=wrong").status == 403
    assert get(console, "/launch").status == 403
    # A proxy forwards for somebody else.
    assert get(console, path, %{}, [{"x-forwarded-for", "10.0.0.7"}]).status == 403
  end

  test "the printed address stands in a file for its owner, which goes with the gateway", %{console: console} do
    file = Path.join(console.dir, "url")
    eventually(fn -> File.read(file) == {:ok, Launch.url(console.gateway, console.url) <> "\n"} end)
    assert %File.Stat{mode: mode} = File.stat!(file)
    assert Bitwise.band(mode, 0o777) == 0o600
    :ok = stop_console(console)
    refute File.exists?(file)
  end

  test "a role is enforced at each event, not only in what is shown", %{console: console} do
    put_vehicle(console, "VID-001")
    {:ok, view, _html} = live(conn(console, :viewer), "/alarms")
    refute has_element?(view, "button", "Acknowledge all")

    assert render_click(view, "alarm-acknowledge", %{"all" => "yes"}) =~
             "Viewers can&#39;t do this"
  end

  test "a page is left when its user gets another role or password, or is removed", %{console: console} do
    for change <- [
          &Users.set_role(&1, "operator", "viewer"),
          &Users.set_password(&1, "operator", "another-password", "boss"),
          &Users.remove(&1, "operator")
        ] do
      {:ok, view, _html} = live(conn(console, :operator), "/")
      {:ok, other, _html} = live(conn(console, :admin), "/")
      :ok = change.(console.gateway)
      assert_redirect(view, "/")
      assert render(other) =~ "Fleet"
    end

    assert conn_of_removed(console) == nil
  end

  defp conn_of_removed(console), do: Users.find(console.gateway, "operator")

  test "pages carry a policy without inline scripts and styles", %{console: console} do
    page = get(console, "/sign-in")
    assert page.headers["content-security-policy"] =~ "default-src 'self'"
    refute page.headers["content-security-policy"] =~ "unsafe"
    refute page.body =~ "style="
    assert page.headers["x-frame-options"] == "DENY"
  end
end
