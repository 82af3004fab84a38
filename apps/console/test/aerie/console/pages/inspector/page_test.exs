defmodule Aerie.Console.Pages.Inspector.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Fleet.Inspector
  alias MavRouter.Recorder
  alias Aerie.Console.Pages.Inspector.Rows
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @moduletag :capture_log

  setup do
    [console: console] = start_console()
    put_link(console, "radio")
    put_vehicle(console, "VID-007", [], %{key: {"main", 7}, system_id: 7})
    {:ok, console: console}
  end

  defp heard(console, message, system \\ 7) do
    bytes = MavCodec.encode(message, system: system, component: 1)
    {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, System.os_time(:microsecond))
    Recorder.link_frames(console.gateway, "radio", frames)
  end

  # The page watches from its mount on; what came before is not seen.
  defp open(console, role \\ :viewer) do
    {:ok, view, _html} = live(conn(console, role), "/inspector")
    view
  end

  defp row(view, name), do: eventually(fn -> has_element?(view, "#messages button", name) end)

  defp attitude(roll), do: %M.Attitude{time_boot_ms: 5, roll: roll}

  test "nobody looks before the page is connected, nor after it is closed", %{console: console} do
    heard(console, attitude(0.5))
    assert Inspector.rows(console.gateway) == []
    view = open(console)
    assert render(view) =~ "No messages yet"
    heard(console, attitude(0.5))
    row(view, "ATTITUDE")
    Process.flag(:trap_exit, true)
    Process.exit(view.pid, :kill)
    eventually(fn -> Inspector.rows(console.gateway) == [] end)
  end

  test "messages with their rate, vehicle and link; fields with units, names and bytes", %{console: console} do
    view = open(console)
    heard(console, attitude(0.5))
    heard(console, %M.Heartbeat{type: 2, autopilot: 3, base_mode: 0x81})
    row(view, "ATTITUDE")
    assert has_element?(view, "#messages td", "VID-007")
    view |> element("#messages button", "HEARTBEAT") |> render_click()
    assert has_element?(view, "#field-type", "QUADROTOR")
    assert has_element?(view, "#field-base_mode", "SAFETY_ARMED")
    assert view |> element("pre.hex") |> render() =~ "FD 09"
    view |> element("#messages button", "ATTITUDE") |> render_click()
    assert has_element?(view, "#field-roll", "28.65 °")
    view |> element("#message button", "") |> render_click()
    refute has_element?(view, "#message")
  end

  test "what is received is shown, with its age from the start; what is forwarded, when asked for", %{
    console: console
  } do
    view = open(console)
    assert has_element?(view, "#filter-direction option[selected]", "received")
    heard(console, attitude(0.5))
    row(view, "ATTITUDE")
    assert has_element?(view, "#messages td[data-label=Age]", ~r/\A\d+ s\z/)
    assert render(view) =~ "Counts start when"
  end

  test "the fields follow; frozen, nothing changes until it goes on", %{console: console} do
    view = open(console)
    heard(console, attitude(0.5))
    row(view, "ATTITUDE")
    view |> element("#messages button", "ATTITUDE") |> render_click()
    heard(console, attitude(0.25))
    eventually(fn -> has_element?(view, "#field-roll", "14.32 °") end)
    view |> element("button", "Freeze") |> render_click()
    heard(console, attitude(0.75))
    heard(console, %M.Ping{seq: 1})
    eventually(fn -> length(Inspector.rows(console.gateway)) == 2 end)
    send(view.pid, :refresh)
    assert has_element?(view, "#field-roll", "14.32 °")
    refute has_element?(view, "#messages button", "PING")
    view |> element("button", "Resume") |> render_click()
    assert has_element?(view, "#field-roll", "42.97 °")
    row(view, "PING")
  end

  test "filters by name, vehicle, link and direction; sorting", %{console: console} do
    view = open(console)
    heard(console, attitude(0.5))
    heard(console, %M.Ping{seq: 1}, 9)
    row(view, "PING")
    filter = fn change -> view |> element("#inspector-filter") |> render_change(change) end
    filter.(%{"text" => "atti"})
    refute has_element?(view, "#messages button", "PING")
    filter.(%{"text" => "4"})
    assert has_element?(view, "#messages button", "PING")
    filter.(%{"text" => "", "vehicle" => "main/7"})
    refute has_element?(view, "#messages button", "PING")
    assert filter.(%{"vehicle" => "", "direction" => "out"}) =~ "No message matches the filter"
    filter.(%{"direction" => ""})
    view |> element("button.sort", "Message") |> render_click()
    assert has_element?(view, "th[aria-sort=descending]", "Message")
    render_click(view, "choose", %{"row" => "no-such-row"})
    refute has_element?(view, "#message")
  end

  test "a viewer can send nothing, whatever the browser says", %{console: console} do
    view = open(console)
    refute has_element?(view, "button", "Send a message")
    assert render_click(view, "compose", %{}) =~ "Ask an operator."
    render_click(view, "send", %{"message" => "HEARTBEAT"})
    refute has_element?(view, "#sent")
  end

  test "an operator sends a message; what is wrong about a field is said", %{console: console} do
    view = open(console, :operator)
    view |> element("button", "Send a message") |> render_click()
    assert has_element?(view, "#compose-form[phx-auto-recover=ignore]")
    form = fn params -> view |> element("#compose-form") |> render_change(params) end
    form.(%{"message" => "PARAM_REQUEST_READ"})
    assert has_element?(view, "#compose-param_index")

    assert form.(%{"message" => "PARAM_REQUEST_READ", "field" => %{"target_system" => "x"}}) =~
             "expected an integer from 0 to 255"

    params = %{
      "message" => "PARAM_REQUEST_READ",
      "field" => %{"target_system" => "77", "param_index" => "-1"}
    }

    view |> element("#compose-form") |> render_submit(params)
    eventually(fn -> has_element?(view, "#sent .badge.bad", "no vehicle with these ids") end)
    render_click(view, "discard", %{})
    refute has_element?(view, "#compose-form")
  end

  test "a message that nobody knows the name of is not sent", %{console: console} do
    view = open(console, :admin)
    view |> element("button", "Send a message") |> render_click()
    assert render_click(view, "send", %{"message" => "NO_SUCH_MESSAGE"}) =~ "there is no message"
    refute has_element?(view, "#sent")
  end

  test "without a recorder the page says what is missing", %{console: console} do
    {:ok, view, _html} = live(conn(console, :viewer), "/inspector")
    :ok = Supervisor.terminate_child(Aerie.Base.Names.via(console.gateway, :console), Aerie.Fleet.Inspector)
    eventually(fn -> has_element?(view, ".state.error", "is not running") end)
  end

  test "rows are bounded, and keep their order" do
    row = %{name: "HEARTBEAT", count: 1, hz: 1.0, at: 5}
    rows = for system <- 1..300, do: Map.put(row, :key, {"radio", :in, system, 1, 0})
    assert {shown, 100} = Rows.rows(rows, Rows.all(), %{"radio" => "main"}, %{}, {:name, :asc}, 10)
    assert Enum.map(shown, &elem(&1.key, 2)) == Enum.to_list(1..200)

    assert {_shown, 0} =
             Rows.rows(
               rows,
               Rows.filter(%{"vehicle" => "main/3"}),
               %{"radio" => "main"},
               %{},
               {:hz, :desc},
               10
             )

    assert Rows.filter(%{"text" => %{"a" => 1}, "other" => "x"}) == Rows.all()
  end
end
