defmodule Aerie.Console.Pages.Diagnosis.PageTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.APICase, only: [request: 3]

  alias MavRouter.Link.Serial.Finding

  setup do: {:ok, start_console()}

  defp collide(console),
    do: put_vehicle(console, "VID-007", [], %{collision: %{at: 1, sign: :position, links: [["a"], ["b"]]}})

  defp busy(console) do
    finding = Finding.failed("/dev/ttyUSB0", {:in_use, "mavproxy.py (process 812)"})
    put_link(console, "serial", %{kind: :serial, status: :down, diagnosis: [finding]})
  end

  # The server looks again after two seconds, and the page follows.
  defp shown(console, text) do
    {:ok, view, _html} = live(conn(console, :viewer), "/diagnosis")

    eventually(fn ->
      html = render(view)
      html =~ text && {view, html}
    end)
  end

  test "nothing is wrong, and what would be shown", %{console: console} do
    {:ok, _view, html} = live(conn(console, :viewer), "/diagnosis")
    assert html =~ "No problems"
  end

  test "conditions with evidence and mend, the serious ones first; a filter by severity", %{console: console} do
    busy(console)
    {view, html} = shown(console, "is in use")
    assert html =~ "mavproxy.py (process 812)"
    assert html =~ "fuser -v /dev/ttyUSB0"
    assert html =~ "/links?link=serial"
    assert view |> element("button", "Errors 1") |> render_click() =~ "is in use"
    html = view |> element("button", "Notices 0") |> render_click()
    refute html =~ "is in use"
    assert html =~ "No match"
    assert view |> element("button", "All 1") |> render_click() =~ "is in use"
  end

  test "a page that is open follows; what is over goes", %{console: console} do
    {:ok, view, _html} = live(conn(console, :viewer), "/diagnosis")
    collide(console)
    eventually(fn -> has_element?(view, "h2", "two vehicles use system id") end)
    assert has_element?(view, "a[href='/vehicles/VID-007']")
    put_vehicle(console, "VID-007")
    eventually(fn -> not has_element?(view, "h2", "two vehicles use system id") end)
  end

  test "the same over REST", %{console: console} do
    busy(console)

    [condition] =
      eventually(fn ->
        {200, _headers, %{"conditions" => conditions}} = request(console.port, "GET", "/api/diagnosis")
        conditions != [] && conditions
      end)

    assert %{"name" => "serial_busy", "severity" => "error", "subject" => "link", "id" => "serial"} =
             condition

    assert %{"evidence" => [_one], "mend" => "End what has it open" <> _} = condition
  end
end
