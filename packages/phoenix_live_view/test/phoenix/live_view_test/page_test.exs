defmodule Phoenix.LiveViewTest.PageTest do
  use ExUnit.Case, async: true

  @moduletag :capture_log

  defmodule Guard do
    import Phoenix.LiveView
    import Phoenix.Component

    def on_mount(:default, _params, %{"user" => user}, socket), do: {:cont, assign(socket, :user, user)}
    def on_mount(:default, _params, _session, socket), do: {:halt, redirect(socket, to: "/login")}
  end

  defmodule Counter do
    use Phoenix.LiveView

    def mount(_params, session, socket),
      do: {:ok, assign(socket, n: 0, name: "", session: session["_csrf_token"], page_title: "0")}

    def handle_params(params, _uri, socket), do: {:noreply, assign(socket, :q, params["q"])}

    def handle_event("up", value, socket) do
      n = socket.assigns.n + String.to_integer(value["by"] || "1")
      {:noreply, socket |> assign(n: n, page_title: "#{n}")}
    end

    def handle_event("name", %{"user" => %{"name" => name}}, socket),
      do: {:noreply, assign(socket, :name, name)}

    def handle_event("patch", _value, socket), do: {:noreply, push_patch(socket, to: "/?q=a%20b")}
    def handle_event("loop", _value, socket), do: {:noreply, push_patch(socket, to: "/?q=loop")}

    def handle_event("go", _value, socket),
      do: {:noreply, socket |> put_flash(:info, "hi") |> redirect(to: "/v/7")}

    def handle_event("away", _value, socket), do: {:noreply, redirect(socket, to: "/login")}
    def handle_event("echo", value, socket), do: {:noreply, push_event(socket, "heard", value)}
    def handle_event("told", _value, socket), do: {:noreply, push_event(socket, "told", %{how: :told})}
    def handle_event("evil", _value, socket), do: {:noreply, redirect(socket, to: "//evil.example")}

    def handle_info({:set, n}, socket), do: {:noreply, assign(socket, :n, n)}

    def render(assigns) do
      ~H"""
      <p id="n">{@n}</p><p id="q">{@q}</p><p id="name">{@name}</p>
      <button phx-click="up">up</button>
      <button id="two" phx-click={Phoenix.LiveView.JS.push("up", value: %{by: "2"})}>two</button>
      <button phx-click="patch">patch</button>
      <button phx-click="go">go</button>
      <button phx-click="away">away</button>
      <.link navigate="/v/1">one</.link>
      <.link patch="/?q=linked">linked</.link>
      <form phx-change="name" phx-submit="name"><input name="user[name]" value={@name} /></form>
      """
    end
  end

  defmodule Vehicle do
    use Phoenix.LiveView

    def mount(%{"id" => id}, _session, socket), do: {:ok, assign(socket, :id, id)}
    def render(assigns), do: ~H"<h1>{@id}</h1>"
  end

  defmodule Private do
    use Phoenix.LiveView
    def render(assigns), do: ~H"<h1>{@user}</h1>"
  end

  defmodule Routes do
    use Phoenix.Router
    import Phoenix.LiveView.Router

    live "/", Counter
    live "/v/:id", Vehicle

    live_session :private, on_mount: [Guard] do
      live "/private", Private
    end
  end

  import Phoenix.LiveViewTest

  setup do
    supervisor = start_supervised!(DynamicSupervisor)

    server =
      Phoenix.LiveView.Server.new(router: Routes, secret: String.duplicate("k", 32), supervisor: supervisor)

    %{conn: conn(server), server: server}
  end

  test "a click changes what is shown, with values and with JS commands", %{conn: conn} do
    {:ok, view, html} = live(conn, "/")
    assert html =~ ~s(<p id="n">0</p>)
    assert view |> element("button", "up") |> render_click() =~ ~s(<p id="n">1</p>)
    assert view |> element("#two") |> render_click() =~ ~s(<p id="n">3</p>)
    assert page_title(view) == "3"
    assert render_click(view, :up, %{by: "4"}) =~ ~s(<p id="n">7</p>)
  end

  test "a message to the view's process is rendered", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")
    for n <- 1..50, do: send(view.pid, {:set, n})
    assert view |> element("#n") |> render() == ~s(<p id="n">50</p>)
  end

  test "forms send what is in them, filled in or not", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")
    assert view |> form("form", %{"user[name]" => "Ann & Bo"}) |> render_change() =~ "Ann &amp; Bo</p>"
    assert view |> form("form") |> render_submit() =~ "Ann &amp; Bo</p>"

    assert_raise ArgumentError, ~r/no field "user\[age\]"/, fn ->
      view |> form("form", %{"user[age]" => 1}) |> render_submit()
    end
  end

  test "patches: by an event, by a link, from the address", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")
    assert view |> element("button", "patch") |> render_click() =~ ~s(<p id="q">a b</p>)
    assert assert_patch(view, "/?q=a%20b") =~ "a b"
    assert view |> element("a", "linked") |> render_click() =~ ~s(<p id="q">linked</p>)
  end

  test "navigation: to another page with its flash, and away", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")

    assert {:error, {:redirect, %{to: "/v/7", flash: %{"info" => "hi"}}}} =
             view |> element("button", "go") |> render_click()

    {:ok, view, _html} = live(conn, "/")
    assert {:error, {:redirect, %{to: "/login"}}} = view |> element("button", "away") |> render_click()
    assert_redirect(view, "/login")
  end

  test "hooks get events, which a test sees as the view pushed them", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")
    render_hook(view, "echo", %{a: 1})
    assert_push_event(view, "heard", %{"a" => 1})
    render_hook(view, "told")
    assert_push_event(view, "told", %{how: :told})
  end

  test "a router tells its paths" do
    assert [%{path: "/", verb: :get}, %{path: "/v/:id"}, %{path: "/private"}] = Phoenix.Router.routes(Routes)
  end

  test "on_mount decides who may see a page, at the request and at the join", %{conn: conn, server: server} do
    assert {:error, {:redirect, %{to: "/login"}}} = live(conn, "/private")
    assert {:ok, _view, "<h1>ann</h1>"} = live(conn(server, %{"user" => "ann"}), "/private")
  end

  test "a path that a browser could take for another server's is refused", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/")
    Process.flag(:trap_exit, true)

    assert {{%ArgumentError{message: "expected a path" <> _}, _stack}, _call} =
             catch_exit(render_click(view, "evil"))
  end

  test "there is no page at other paths", %{conn: conn} do
    assert live(conn, "/nothing") == {:error, :not_found}
    assert {:ok, _view, "<h1>ä/b</h1>"} = live(conn, "/v/%C3%A4%2Fb")
    assert live(conn, "/v/%FF") == {:error, :not_found}
  end
end
