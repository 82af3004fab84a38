defmodule Aerie.Console.Pages.Params.PageTest do
  @moduledoc "Parameters of a simulated vehicle behind UDP, by the page."
  use Aerie.ConsoleCase, async: true

  import Aerie.TransferCase, only: [fly: 3]

  alias Aerie.Console.Pages.Params.Listing

  @moduletag :tmp_dir
  @moduletag :capture_log
  @path "/params?vehicle=VID-001"

  setup %{tmp_dir: dir} = context do
    {gateway, port} = Aerie.TransferCase.start(dir)
    [console: console] = start_console(gateway: gateway)
    sim = context[:sim] || [firmware: :ardupilot]
    %{console: console, sim: fly(gateway, port, [files: files(dir)] ++ sim)}
  end

  # What a PX4 has on board about its parameters.
  @general "etc/extras/component_general.json.xz"
  @about %{
    version: 1,
    parameters: [
      %{
        name: "MIS_TAKEOFF_ALT",
        type: "Float",
        shortDesc: "Default take-off altitude",
        units: "m",
        min: 0,
        max: 80
      }
    ]
  }

  defp files(dir) do
    path = Path.join(dir, "general")
    types = [%{type: 1, uri: "mftp:///etc/extras/parameters.json"}]
    File.write!(path, JSON.encode!(%{version: 1, metadataTypes: types}))
    {packed, 0} = System.cmd("xz", ["--stdout", "--check=crc32", path])
    %{@general => packed, "/etc/extras/parameters.json" => JSON.encode!(@about)}
  end

  defp open(console, role) do
    {:ok, view, _html} = live(conn(console, role), @path)
    eventually(fn -> has_element?(view, "#params") end)
    view
  end

  # As the button says for what it is: the value that the table shows.
  defp command(view, type, id, fields, shown \\ nil) do
    shown = shown || Listing.target("VID-001", nil, value(view, fields["name"]))
    render_hook(view, "command", %{"type" => type, "id" => id, "fields" => fields, "shown" => shown})
  end

  defp value(view, name) do
    with true <- name != nil and has_element?(view, "#param-#{name} strong"),
         [_all, text] <- Regex.run(~r/>([^<]*)</, view |> element("#param-#{name} strong") |> render()),
         do: text
  end

  @tag :chromium
  test("in a browser: a parameter is found, set, and is so after a reload", %{console: console},
    do: browse(console, "params.mjs")
  )

  test "read, searched, set by an admin, compared with a file, loaded and saved", %{console: console} do
    view = open(console, :admin)

    refute view |> element("#params-filter") |> render_change(%{"search" => "pilot tkoff", "only" => "all"}) =~
             "RTL_ALT"

    view |> element("#param-PILOT_TKOFF_ALT a") |> render_click()
    assert has_element?(view, "#param-editor", "PILOT_TKOFF_ALT")

    assert command(view, "set", "p0", %{"name" => "PILOT_TKOFF_ALT", "value" => "high"}) =~
             "expected a number"

    assert command(view, "set", "p0", %{"name" => "NO_SUCH", "value" => "1"}) =~ "no parameter of this name"
    before = value(view, "PILOT_TKOFF_ALT")
    command(view, "set", "p1", %{"name" => "PILOT_TKOFF_ALT", "value" => "150"})
    eventually(fn -> has_element?(view, "#params-commands-p1[data-state=completed]", "was #{before}") end)
    eventually(fn -> has_element?(view, "#param-PILOT_TKOFF_ALT strong", "150") end)

    # Somebody who still sees the value of before changes nothing.
    assert command(
             view,
             "set",
             "p2",
             %{"name" => "PILOT_TKOFF_ALT", "value" => "80"},
             Listing.target("VID-001", nil, before)
           ) =~
             "nothing was sent"

    # It can be set back, from a page that was loaded since as well.
    {:ok, again, _html} = live(conn(console, :admin), @path)
    eventually(fn -> has_element?(again, "#params") end)
    again |> element("#params-undo a") |> render_click()
    assert has_element?(again, "#param-value[value='#{before}']")

    render_hook(view, "open_file", %{"name" => "mine.param", "text" => "PILOT_TKOFF_ALT,200\nNO_SUCH,1\n"})
    assert has_element?(view, "#params-file", "1 differ from the vehicle; the vehicle does not have NO_SUCH")
    assert has_element?(view, "#params-load")
    assert command(view, "load", "l0", %{}) =~ "The vehicle or its values changed; nothing was sent."
    [shown] = Regex.run(~r/VID-001 autopilot \d+/, view |> element("#params-load") |> render())
    command(view, "load", "l1", %{}, shown)
    eventually(fn -> has_element?(view, "#params-commands-l1[data-state=completed]") end)
    eventually(fn -> has_element?(view, "#params-file", "0 differ") end)

    # Of QGroundControl's file only the autopilot's rows; the rest is told. Another vehicle's file is refused.
    rows = "1\t1\tPILOT_TKOFF_ALT\t250\t4\n1\t154\tMNT_ANGLE\t2\t6\n"
    render_hook(view, "open_file", %{"name" => "qgc.params", "text" => rows})
    assert has_element?(view, "#params-file", "1 parameters, 1 differ from the vehicle.")
    assert has_element?(view, "#params-file", "component 154 and not of the autopilot: MNT_ANGLE")

    assert render_hook(view, "open_file", %{"name" => "b", "text" => "7\t1\tA\t1\t6\n"}) =~
             "system id 7, not of 1"

    render_hook(view, "save", %{"format" => "param"})
    assert_push_event(view, "params:file", %{name: "VID-001.param", text: text}, Aerie.Patience.ms())
    assert text =~ ~r/PILOT_TKOFF_ALT,200/
    assert render_hook(view, "open_file", %{"name" => "odd", "text" => "what is this"}) =~ "line 1"
    assert render_hook(view, "open_file", %{"error" => "too large"}) =~ "too large"
  end

  @tag sim: [firmware: :px4, camera: 100]
  test "what the vehicle says about its parameters, and a camera's own, text among them", %{console: console} do
    view = open(console, :admin)
    view |> element("button", "Descriptions") |> render_click()
    eventually(fn -> has_element?(view, "#param-MIS_TAKEOFF_ALT", "Default take-off altitude") end)
    refute has_element?(view, "button", "Descriptions")
    view |> element("#params-filter") |> render_change(%{"search" => "take-off altitude", "only" => "all"})
    view |> element("#param-MIS_TAKEOFF_ALT a") |> render_click()
    assert has_element?(view, "#param-editor", "0 to 80")

    # It is heard by its heartbeat.
    eventually(fn ->
      send(view.pid, :refresh)
      has_element?(view, "#params-component option[value='100']", "camera (100)")
    end)

    view |> element("#params-vehicle") |> render_change(%{"vehicle" => "VID-001", "component" => "100"})
    eventually(fn -> has_element?(view, "#param-CAM_NAME") end)
    refute has_element?(view, "label[for=params-open]")
    refute has_element?(view, "button", "Descriptions")
    view |> element("#param-CAM_NAME a") |> render_click()
    # A press that was made while the autopilot's were shown.
    assert command(view, "set", "c0", %{"name" => "CAM_NAME", "value" => "Front"}) =~ "nothing was sent"
    camera = Listing.target("VID-001", 100, value(view, "CAM_NAME"))
    command(view, "set", "c1", %{"name" => "CAM_NAME", "value" => "Rear"}, camera)
    eventually(fn -> has_element?(view, "#params-commands-c1[data-state=completed]") end)
    eventually(fn -> has_element?(view, "#param-CAM_NAME strong", "Rear") end)
    view |> element("#param-CAM_MODE a") |> render_click()
    mode = Listing.target("VID-001", 100, value(view, "CAM_MODE"))
    assert command(view, "set", "c2", %{"name" => "CAM_MODE", "value" => "x"}, mode) =~ "expected a number"

    # Events that belong to what this page does not show now.
    render_hook(view, "save", %{"format" => "param"})
    render_hook(view, "open_file", %{"name" => "mine.param", "text" => "CAM_MODE,1"})
    refute has_element?(view, "#params-file")
    {:ok, _view, html} = live(conn(console, :viewer), @path <> "&component=300")
    assert html =~ "VID-001"
  end

  test "setting is held, and longer what protects the vehicle", %{console: console} do
    view = open(console, :admin)
    view |> element("#param-PILOT_TKOFF_ALT a") |> render_click()
    assert has_element?(view, "#param-form #param-set.hold-800")
    refute has_element?(view, "#param-form [type=submit]")
    {:ok, view, _html} = live(conn(console, :admin), @path <> "&p=FENCE_ALT_MAX")
    eventually(fn -> has_element?(view, "#param-set.hold-1500.danger") end)
    assert has_element?(view, "#param-form", "What protects the vehicle changes: FENCE_ALT_MAX.")
    refute has_element?(view, "#param-form", "may be")

    render_hook(view, "open_file", %{"name" => "mine.param", "text" => "PILOT_TKOFF_ALT,200\n"})
    assert has_element?(view, "#params-load.hold-800")

    render_hook(view, "open_file", %{
      "name" => "mine.param",
      "text" => "FENCE_ALT_MAX,200\nPILOT_TKOFF_ALT,200\n"
    })

    assert has_element?(view, "#params-load.hold-1500.danger")
  end

  test "a viewer reads; neither viewer nor operator sets", %{console: console} do
    view = open(console, :viewer)
    assert command(view, "set", "p1", %{"name" => "RTL_ALT", "value" => "1"}) =~ "Viewers can"
    view = open(console, :operator)
    {:ok, _view, html} = live(conn(console, :operator), @path <> "&p=RTL_ALT")
    refute html =~ "param-form"
    command(view, "set", "p2", %{"name" => "RTL_ALT", "value" => "1"})
    eventually(fn -> has_element?(view, "#params-commands-p2[data-state=denied]", "maintain") end)
  end

  test "a vehicle that does not answer: the page says so, and reading can be stopped", %{
    console: console,
    sim: sim
  } do
    for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, 1.0, direction)
    {:ok, view, _html} = live(conn(console, :viewer), @path)
    eventually(fn -> has_element?(view, "#params-progress") end)
    refute view |> element("#params-progress button") |> render_click() =~ "params-progress"
    assert has_element?(view, "button", "Read")
    {:ok, _view, html} = live(conn(console, :viewer), "/params?vehicle=VID-999")
    assert html =~ "No vehicle chosen"
  end
end
