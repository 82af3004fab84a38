defmodule Aerie.Console.RefreshTest.Page do
  @moduledoc false
  use Aerie.Console, {:page, events: [viewer: ~w(look), admin: ~w(change)]}

  def mount(_params, _session, socket),
    do: {:ok, socket |> assign(n: 0, last: "") |> subscribe([:vehicles, :events])}

  def handle_info(:refresh, socket), do: {:noreply, update(socket, :n, &(&1 + 1))}
  def handle_info({:fleet, :events, event}, socket), do: {:noreply, assign(socket, :last, event)}
  def handle_event(event, _value, socket), do: {:noreply, assign(socket, :last, event)}

  def render(assigns) do
    ~H"""
    <p id="n">{@n}</p><p id="last">{@last}</p>
    """
  end
end

defmodule Aerie.Console.RefreshTest.Routes do
  @moduledoc false
  use Phoenix.Router, helpers: false
  import Phoenix.LiveView.Router

  alias Aerie.Console.Pages.Alarms
  alias Aerie.Console.SignIn.OnMount

  live_session :test, on_mount: [OnMount, Alarms.OnMount] do
    live "/", Aerie.Console.RefreshTest.Page
  end
end

defmodule Aerie.Console.RefreshTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Console.RefreshTest.Routes

  setup do: {:ok, start_console()}

  defp page(console, role) do
    {:ok, view, _html} = live(conn(console, role, Routes), "/")
    view
  end

  defp n(view),
    do: view |> element("#n") |> render() |> then(&Regex.run(~r/\d+/, &1)) |> hd() |> String.to_integer()

  test "many changes make few refreshes; without any there is one now and then", %{console: console} do
    # Its page refreshes from its mount on, and a busy machine may return from `page/2` much later.
    begun = System.monotonic_time(:millisecond)
    view = page(console, :viewer)
    for n <- 1..400, do: put_vehicle(console, "VID-#{rem(n, 20)}")
    eventually(fn -> n(view) > 0 end)
    seen = n(view)
    # Five a second at most, whatever time this took.
    assert seen <= div(System.monotonic_time(:millisecond) - begun, 200) + 2
    eventually(fn -> n(view) >= seen + 2 end)
  end

  test "messages of other topics reach the page as they are", %{console: console} do
    view = page(console, :viewer)
    Aerie.Base.PubSub.publish(console.gateway, :events, "an event")
    eventually(fn -> view |> element("#last") |> render() =~ "an event" end)
  end

  test "an event needs the role that the page names, and operator if it names none", %{console: console} do
    for {role, may} <- [
          viewer: ~w(look),
          operator: ~w(look fly),
          admin: ~w(look fly change)
        ] do
      view = page(console, role)

      for event <- ~w(look fly change) do
        html = render_click(view, event)
        assert html =~ ~s(<p id="last">#{event}</p>) == event in may
        render_click(view, "lv:clear-flash")
      end
    end
  end
end
