defmodule FleetWeb.Console.AlarmsTest do
  use FleetWeb.ConsoleCase, async: true

  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Alarms.Server
  alias Aerie.Vehicle.Event

  setup do: {:ok, start_console()}

  test "alarms show on every page, and somebody's seeing them on everybody's", %{console: console} do
    {:ok, one, _html} = live(conn(console, :operator), "/")
    {:ok, other, _html} = live(conn(console, :viewer), "/alarms")
    put_vehicle(console, "VID-009", [], %{status: :lost})

    for view <- [one, other],
        do:
          eventually(fn ->
            has_element?(view, "#alarm-strip .alarm-text", "Lost contact while armed") and
              has_element?(view, "#alarm-strip a[href='/vehicles/VID-009']", "VID-009") and
              has_element?(view, "#alarm-strip .alarm-age", ~r/\A\s*\d+ s\s*\z/)
          end)

    eventually(fn -> render(other) =~ "alarm-row active" end)
    assert has_element?(other, "#alarms a[href='/vehicles/VID-009']", "VID-009")
    one |> element("#alarm-strip button", "Acknowledge") |> render_click()
    eventually(fn -> other |> element("#alarms") |> render() =~ "operator" end)

    put_vehicle(console, "VID-009")
    eventually(fn -> other |> element("#alarm-strip") |> render() =~ "No alarms" end)
  end

  test "diagnosis and its alarms agree", %{console: console} do
    {:ok, view, _html} = live(conn(console, :operator), "/alarms")
    put_vehicle(console, "VID-001", [], %{collision: %{at: 1, sign: :position, links: [["a"], ["b"]]}})
    eventually(fn -> render(view) =~ "two vehicles use system id" end)
    [%{title: title}] = Aerie.Fleet.Diagnosis.list(console.gateway)
    assert {[%{text: ^title, vehicle: "VID-001", severity: :critical}], 0} = Server.list(console.gateway)
  end

  test "events become alarms; a restart finds those of the journal", %{console: console} do
    {:ok, view, _html} = live(conn(console, :operator), "/alarms")

    event =
      Event.new("VID-001", "gps.lost", 1, System.os_time(:microsecond), nil, %{"fix_name" => "NO_FIX"})

    PubSub.publish(console.gateway, :events, event)
    eventually(fn -> render(view) =~ "GNSS position lost" end)
    assert %{sound: :critical} = Server.summary(console.gateway)
  end
end
