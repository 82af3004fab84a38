defmodule Aerie.Console.Pages.Events.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Policy.Audit
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal

  @all %{"vehicle" => "", "type" => "", "text" => "", "hours" => "24", "level" => "all"}

  setup do
    [console: console] = start_console()
    {:ok, console: console, now: System.os_time(:microsecond)}
  end

  defp put(console, vehicle, type, seq, time, data) do
    :ok =
      Journal.commit(console.gateway, vehicle, %{seq: seq}, [Event.new(vehicle, type, seq, time, nil, data)])
  end

  defp open(console, role \\ :viewer) do
    {:ok, view, _html} = live(conn(console, role), "/events")
    view
  end

  defp filter(view, changes) do
    view
    |> element("#events-filter")
    |> render_change(Map.merge(@all, changes))
  end

  defp texts(view) do
    for [_all, text] <- Regex.scan(~r/data-label="Text"[^>]*>\s*([^<]*?)\s*</, render(view)), do: text
  end

  test "newest first, filtered, and new ones as they come", %{console: console, now: now} do
    put(console, "eagle", "landed", 1, now - 3_000_000, %{})
    put(console, "kite", "failsafe", 1, now - 2_000_000, %{"reason" => "battery", "action" => "rtl"})
    put(console, "eagle", "statustext", 2, now - 5_000_000_000, %{"text" => "hello", "severity" => 6})
    view = open(console)
    eventually(fn -> has_element?(view, "#events") end)
    assert [failsafe, "landed", "hello"] = texts(view)
    assert failsafe =~ "battery"
    assert has_element?(view, "#events a[href='/vehicles/kite/events']")
    assert render(view) =~ ~r{/replay\?at=20\d\d-\d\d-\d\dT\d\d%3A\d\d%3A\d\dZ&(amp;)?vehicles=kite}

    put(console, "kite", "statustext", 2, now, %{"text" => "<b>new</b>", "severity" => 4})
    eventually(fn -> render(view) =~ "&lt;b&gt;new" end)

    for {change, expected} <- [
          {%{"vehicle" => "eagle"}, 2},
          {%{"type" => "fail"}, 1},
          {%{"level" => "error"}, 1},
          {%{"text" => "HELLO"}, 1},
          {%{"hours" => "1"}, 3},
          {%{"hours" => "99999", "vehicle" => "none"}, 0}
        ] do
      filter(view, change)
      eventually(fn -> length(texts(view)) == expected end)
    end
  end

  test "pages", %{console: console, now: now} do
    for n <- 1..150,
        do: put(console, "eagle", "statustext", n, now - (200 - n) * 1_000_000, %{"text" => "t#{n}"})

    view = open(console)
    eventually(fn -> texts(view) |> length() == 100 end)
    assert hd(texts(view)) == "t150"
    view |> element("button", "Older") |> render_click()
    eventually(fn -> texts(view) |> hd() == "t50" end)
    assert length(texts(view)) == 50
    # Older ones stay as they are.
    put(console, "eagle", "statustext", 151, now, %{"text" => "t151"})
    assert hd(texts(view)) == "t50"
    view |> element("button", "Newest") |> render_click()
    eventually(fn -> texts(view) |> hd() == "t151" end)
  end

  @tag :tmp_dir
  test "commands stand among the events for operators, each with its record", %{
    console: console,
    now: now,
    tmp_dir: dir
  } do
    start_supervised!({Audit, gateway: console.gateway, dir: Path.join(dir, "audit"), max_bytes: 8_000_000})
    put(console, "eagle", "landed", 1, now - 3_000_000, %{})
    given = %{"command" => "goto", "vehicle" => "eagle", "source" => "ann", "type" => "decision"}
    refused = Map.merge(given, %{"decision" => "deny", "rule" => "geofence", "reason" => "outside the fence"})
    {:ok, n} = Audit.append(console.gateway, refused)
    {:ok, _n} = Audit.append(console.gateway, Map.merge(refused, %{"vehicle" => nil}))
    done = Map.merge(given, %{"command" => "rtl", "type" => "result", "result" => "completed"})
    {:ok, _n} = Audit.append(console.gateway, done)

    view = open(console, :operator)
    eventually(fn -> has_element?(view, "#events a[href='/audit?record=#{n}']") end)

    assert ["rtl completed, by ann", "goto refused: outside the fence, rule geofence, by ann", "landed"] =
             texts(view)

    for {change, expected} <- [
          {%{"type" => "command.refused"}, 1},
          {%{"type" => "command"}, 2},
          {%{"text" => "GEOFENCE"}, 1},
          {%{"level" => "notice", "vehicle" => "eagle"}, 1}
        ] do
      filter(view, change)
      eventually(fn -> length(texts(view)) == expected end)
    end

    viewer = open(console)
    eventually(fn -> texts(viewer) == ["landed"] end)
    # The link shows this record first.
    {:ok, audit, _html} = live(conn(console, :operator), "/audit?record=#{n}")
    eventually(fn -> has_element?(audit, "#record-#{n}", "geofence") end)
    refute has_element?(audit, "#record-#{n + 1}")

    for wrong <- ["x", "-1", "99999999999999999999"],
        do: {:ok, _view, _html} = live(conn(console), "/audit?record=#{wrong}")
  end

  test "an empty fleet, and what else a stranger sends", %{console: console} do
    view = open(console)
    eventually(fn -> render(view) =~ "No event matches" end)
    render_hook(view, "older", %{})
    render_hook(view, "filter", %{"hours" => %{"a" => 1}, "text" => 7})
    eventually(fn -> render(view) =~ "No event matches" end)
  end
end
