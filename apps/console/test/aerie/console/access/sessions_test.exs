defmodule Aerie.Console.Access.SessionsTest do
  @moduledoc "A session ends everywhere at once: for copies of its cookie, for open pages, and for their WebSocket."
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Access.{Launch, Sessions, Users}
  alias Aerie.WSClient
  alias Phoenix.LiveView.Cookie

  @moduletag :capture_log

  setup do: {:ok, start_console()}

  # A browser that has signed in, with a WebSocket of its page.
  defp tab(console, name) do
    jar = sign_in(console, name, password(name)).jar
    %{status: 200, body: html} = get(console, "/", jar)
    %{jar: jar, csrf: csrf(html), socket: socket(console, jar, csrf(html))}
  end

  defp socket(console, jar, csrf) do
    cookie = Enum.map_join(jar, "; ", fn {name, value} -> "#{name}=#{value}" end)
    query = URI.encode_query(%{"_csrf_token" => csrf, "vsn" => "2.0.0"})
    WSClient.open(console.port, "/live/websocket?" <> query, headers: [{"cookie", cookie}])
  end

  defp sign_out(console, %{jar: jar, csrf: csrf}),
    do: post(console, "/sign-out", jar, %{"_csrf_token" => csrf})

  defp dead?(console, jar),
    do: match?(%{status: 302, headers: %{"location" => "/sign-in"}}, get(console, "/", jar))

  test "a copied cookie opens nothing after the sign-out, and the WebSocket is closed", %{console: console} do
    browser = tab(console, :operator)
    other = tab(console, :operator)
    assert sign_out(console, browser).status == 303
    assert dead?(console, browser.jar)
    assert get(console, "/download/audit", browser.jar).status in [302, 303, 403]
    assert {{8, <<1008::16, _words::binary>>}, _client} = WSClient.recv(browser.socket)
    # The same user elsewhere.
    refute dead?(console, other.jar)
  end

  test "open pages of the session are left, those of another one stay", %{console: console} do
    one = conn(console, :operator)
    {:ok, view, _html} = live(one, "/")
    {:ok, tab, _html} = live(one, "/alarms")
    {:ok, other, _html} = live(conn(console, :operator), "/")
    :ok = Sessions.finish(console.gateway, one.session["id"])
    assert_redirect(view, "/")
    assert_redirect(tab, "/alarms")
    assert render(other) =~ "Fleet"
    assert {:error, {:redirect, %{to: "/sign-in"}}} = live(one, "/")
  end

  test "another role, another password and a removal end every session of the user", %{console: console} do
    for change <- [
          &Users.set_role(&1, "operator", "viewer"),
          &Users.set_password(&1, "operator", password(:operator), "boss"),
          &Users.remove(&1, "operator")
        ] do
      browser = tab(console, :operator)
      admin = tab(console, :admin)
      :ok = change.(console.gateway)
      assert dead?(console, browser.jar)
      assert {{8, <<1008::16, _words::binary>>}, _client} = WSClient.recv(browser.socket)
      refute dead?(console, admin.jar)
    end
  end

  test "a restart signs nobody out, and brings no session back", %{console: console} do
    stays = tab(console, :operator)
    left = tab(console, :operator)
    sign_out(console, left)
    :ok = stop_console(console)

    [console: again] = start_console(dir: console.dir, gateway: console.gateway, port: console.port)
    refute dead?(again, stays.jar)
    assert dead?(again, left.jar)
    assert Bitwise.band(File.stat!(Path.join(console.dir, "sessions.json")).mode, 0o777) == 0o600
    refute File.read!(Path.join(console.dir, "sessions.json")) =~ session(again, stays.jar)["id"]
  end

  defp session(%{server: server}, jar) do
    request = %{headers: %{"cookie" => Enum.map_join(jar, "; ", fn {name, value} -> "#{name}=#{value}" end)}}
    Cookie.read(request, server.secret, server.cookie)
  end

  test "a session of the printed address can be ended", %{console: console} do
    "http://" <> _rest = url = Launch.url(console.gateway, console.url)
    jar = get(console, String.replace_prefix(url, console.url, "")).jar
    %{status: 200, body: html} = get(console, "/", jar)
    sign_out(console, %{jar: jar, csrf: csrf(html)})
    assert dead?(console, jar)
  end
end
