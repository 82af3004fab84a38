defmodule Phoenix.LiveView.View.LifecycleTest do
  use ExUnit.Case, async: true

  @moduletag :capture_log

  defmodule Hooks do
    import Phoenix.LiveView
    import Phoenix.Component

    def on_mount(:attach, params, _session, socket) do
      socket =
        socket
        |> assign(:seen, [])
        |> attach_hook(:params, :handle_params, fn _params, _uri, socket -> {:cont, seen(socket, :params)} end)
        |> attach_hook(:event, :handle_event, fn
          "stop", _value, socket -> {:halt, seen(socket, :stop)}
          _event, _value, socket -> {:cont, seen(socket, :event)}
        end)
        |> attach_hook(:info, :handle_info, fn _message, socket -> {:halt, seen(socket, :info)} end)

      if params["again"],
        do: {:cont, attach_hook(socket, :info, :handle_info, fn _, socket -> {:cont, socket} end)},
        else: {:cont, socket}
    end

    def on_mount(:forgetful, _params, _session, socket), do: {:halt, socket}
    defp seen(socket, what), do: update(socket, :seen, &[what | &1])
  end

  defmodule Layout do
    use Phoenix.Component
    def live(assigns), do: ~H"<main>{@inner_content}</main>"
  end

  defmodule Page do
    use Phoenix.LiveView

    def handle_params(_params, _uri, socket), do: {:noreply, socket}

    def handle_event(_event, _value, socket),
      do: {:noreply, clear_flash(put_flash(socket, :info, "x"), :error)}

    def render(assigns),
      do: ~H|<p>{inspect(@seen)}{@flash["info"]}{@socket.id != nil}</p>|
  end

  defmodule Forgetful do
    use Phoenix.LiveView
    def render(assigns), do: ~H""
  end

  defmodule Silent do
    use Phoenix.LiveView
    def render(assigns), do: ~H"<p>silent</p>"
  end

  defmodule Routes do
    use Phoenix.Router
    import Phoenix.LiveView.Router

    live_session :attach, on_mount: [{Hooks, :attach}], layout: {Layout, :live} do
      live "/", Page
    end

    live_session :forgetful, on_mount: [{Hooks, :forgetful}] do
      live "/forgetful", Forgetful
    end

    live "/silent", Silent
  end

  import Phoenix.LiveViewTest

  setup do
    supervisor = start_supervised!(DynamicSupervisor)

    %{
      conn:
        conn(
          Phoenix.LiveView.Server.new(
            router: Routes,
            secret: String.duplicate("k", 32),
            supervisor: supervisor
          )
        )
    }
  end

  test "hooks see what the view's callbacks would, and may keep it from them", %{conn: conn} do
    {:ok, view, html} = live(conn, "/")
    assert html == "<main><p>[:params]true</p></main>"
    assert render_click(view, "any") =~ "[:event, :params]xtrue"
    assert render_click(view, "stop") =~ "[:stop, :event, :params]x"
    send(view.pid, :message)
    assert render(view) =~ "[:info, :stop,"
    assert render_click(view, "lv:clear-flash", %{key: "info"}) =~ "]true"
  end

  test "mistakes with hooks raise", %{conn: conn} do
    assert_raise ArgumentError, ~r/hook :info at :handle_info already/, fn -> live(conn, "/?again=1") end
    assert_raise ArgumentError, ~r/on_mount halted without a redirect/, fn -> live(conn, "/forgetful") end
  end

  test "a message that a view does not handle does not end it", %{conn: conn} do
    {:ok, view, _html} = live(conn, "/silent")
    send(view.pid, :hello)
    assert render(view) == "<p>silent</p>"
  end
end
