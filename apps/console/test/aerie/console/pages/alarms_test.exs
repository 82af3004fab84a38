defmodule Aerie.Console.Pages.AlarmsTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Fleet.Alarms
  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Events.{Detector, Journal}
  alias Aerie.Vehicle.Events.Detector.Observation

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
    # Why, what to do, and where to go; a viewer is not offered what the server would refuse.
    for text <- ["What to do", "Its own failsafe acts now."],
        do: assert(has_element?(other, "#alarms .alarm-row", text))

    assert has_element?(one, "#alarm-strip .alarm-text[role=alert]", "VID-009")

    for selector <- ["#alarms", "#alarm-strip"],
        do: refute(has_element?(other, selector <> " button", "Acknowledge"))

    {:ok, operator, _html} = live(conn(console, :operator), "/alarms")
    assert has_element?(operator, "#alarms section[aria-label='Alarms of VID-009'] button", "Acknowledge")
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
    assert {[%{text: ^title, vehicle: "VID-001", severity: :critical}], 0} = Alarms.list(console.gateway)
  end

  # A step of the vehicle's detector, as its event loop commits it.
  defp observe(console, detector, at_s, changes) do
    data =
      Map.merge(%{mode: "GUIDED", armed: true, in_air: true, gps: "OK", remaining: 0.9}, Map.new(changes))

    at = System.os_time(:microsecond) + at_s * 1_000_000
    {detector, events, params} = Detector.observe(detector, Observation.new(:state, at, 1000, data))
    :ok = Journal.commit(console.gateway, "VID-001", detector, events, params)
    detector
  end

  test "events begin alarms, and the vehicle's state ends them, on the page and for the ear", %{
    console: console
  } do
    put_vehicle(console, "VID-001")
    {:ok, view, _html} = live(conn(console, :operator), "/alarms")
    new = Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))
    detector = observe(console, new, 0, [])
    detector = observe(console, detector, 1, gps: "NO_FIX", remaining: 0.05)

    eventually(fn ->
      render(view) =~ "GNSS position lost" and render(view) =~ "Battery nearly empty, 5 % left"
    end)

    assert %{sound: :critical} = Alarms.summary(console.gateway)

    detector = observe(console, detector, 2, gps: "OK", remaining: 0.94)
    eventually(fn -> match?(%{sound: nil, counts: %{critical: 0}}, Alarms.summary(console.gateway)) end)
    eventually(fn -> view |> element("#alarms") |> render() |> String.split("Cleared") |> length() == 3 end)
    refute render(view) =~ "94 % left"
    assert detector.conditions == []
  end
end
