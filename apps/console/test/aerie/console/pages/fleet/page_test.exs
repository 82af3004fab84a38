defmodule Aerie.Console.Pages.Fleet.PageTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.ShadowCase, only: [start_shadow: 2]

  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Firmware.Modes

  setup do: {:ok, start_console()}

  defp open(console, path \\ "/", role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), path)
    view
  end

  defp shown(view),
    do: Regex.scan(~r/data-id="([^"]+)"/, render(view), capture: :all_but_first) |> List.flatten()

  defp selected(view) do
    ~r/data-id="([^"]+)"[^>]*aria-selected="true"/
    |> Regex.scan(render(view), capture: :all_but_first)
    |> List.flatten()
  end

  test "without vehicles it says what would bring some", %{console: console} do
    assert console |> open() |> render() =~ "No vehicle has been heard yet"
  end

  test "a row has what an operator wants to know at a glance", %{console: console} do
    put_vehicle(console, "VID-001", mode: %{failsafe: true}, battery: %{remaining: 0.12})

    put_vehicle(console, "VID-002", [], %{
      status: :lost,
      # In minutes, which a busy machine does not miss.
      last_heard: System.os_time(:microsecond) - 90 * 60_000_000
    })

    view = open(console)
    html = render(view)

    for text <- ["failsafe", "Guided", "3D · 14", "battery 12 %"], do: assert(html =~ text)

    # Units stand once in the heads; a bar is for a charge that begins to matter.
    for {name, text} <- [{"Battery", "12"}, {"Height", "20"}, {"Speed", "3.0"}],
        do: assert(has_element?(view, "#vehicle-VID-001 td[data-label=#{name}]", ~r/\A\s*#{text}\s*\z/))

    assert has_element?(view, "thead", ~r/Speed\s+m\/s/)
    assert has_element?(view, "#vehicle-VID-001 .meter.bad")
    refute has_element?(view, "#vehicle-VID-002 .meter")

    assert view |> element("#vehicle-VID-002") |> render() =~ "90 min"
    assert view |> element("#vehicle-VID-002") |> render() =~ "lost"
    assert html =~ "2 vehicles"
  end

  test "a row on the ground has its readiness in place of alarms, with every reason", %{console: console} do
    ground = [mode: %{armed: false, in_air: false}, health: %{ready_to_arm: true}]
    # However slow the machine is, they were heard just now.
    heard = System.os_time(:microsecond) + 3_600_000_000
    booted = %{time_boot_ms: 60_000, last_heard: heard, memory: %{mode_names: %{}}}
    put_vehicle(console, "READY", ground, booted)
    put_vehicle(console, "LOW", ground ++ [battery: %{remaining: 0.2}, gps: %{satellites: 6}], booted)
    put_vehicle(console, "FLIES", [], booted)
    view = open(console)

    cell = fn id -> view |> element("#vehicle-#{id} td.fleet-problems") |> render() end
    assert cell.("READY") =~ ~r/ready ready.*●.*Ready/s

    assert cell.("LOW") =~
             ~r/title="Battery: 20 % left; 40 % are wanted\.\nGPS: 6 satellites.*✕.*Not ready.*2/s

    refute cell.("FLIES") =~ "ready"

    view |> element("button[phx-value-flag=unready]") |> render_click()
    assert_patch(view, "/?unready=1")
    assert shown(view) == ["LOW"]
    assert console |> open("/?sort=problems") |> shown() == ["LOW", "FLIES", "READY"]
  end

  @tag :chromium
  test "nothing of a row is cut, whatever the firmware calls its modes", %{console: console} do
    modes =
      for {autopilot, kinds} <- [ardupilot: ~w(copter plane vtol rover boat sub), px4: ["copter"]],
          kind <- kinds,
          mode <- Modes.all(autopilot, kind),
          do: mode

    problems = [
      %{},
      %{mode: %{failsafe: true}, mission: %{fence_breach: true}},
      %{battery: %{remaining: 1.0, charge_state: "EMERGENCY"}},
      %{mission: %{fence_breach: true}, gps: %{fix: 4, satellites: 22}}
    ]

    for {mode, n} <- Enum.with_index(Enum.uniq(modes) ++ ["MODE(4294967295)", "FAILSAFE"], 1) do
      groups =
        Map.merge(Enum.at(problems, rem(n, 4)), %{
          velocity: %{groundspeed: 123.4},
          position: %{alt_rel: -1234.0}
        })

      groups = Map.update(groups, :mode, %{mode: mode}, &Map.put(&1, :mode, mode))
      groups = if rem(n, 5) == 0, do: put_in(groups.mode[:armed], false), else: groups
      status = Enum.at([:online, :stale, :lost], rem(n, 3))
      fields = %{key: {"main", n}, system_id: n, status: status, links: ["radio"]}
      put_vehicle(console, "V#{n}", Map.to_list(groups), fields)
    end

    put_link(console, "radio", %{quality: %{score: 100.0}})
    browse(console, "table.mjs")
  end

  test "says so when nobody is heard any more", %{console: console} do
    put_vehicle(console, "VID-001", [], %{status: :stale})
    assert console |> open() |> render() =~ "No vehicle is heard. What you see is what was last known."
  end

  test "what changes is shown by itself", %{console: console} do
    put_vehicle(console, "VID-001")
    view = open(console, "/", :viewer)
    assert has_element?(view, "#vehicle-VID-001 td.fleet-mode", ~r/\AGuided\z/)
    put_vehicle(console, "VID-001", mode: %{mode: "AUTO_RTL"})
    eventually(fn -> has_element?(view, "#vehicle-VID-001 td[title=AUTO_RTL]", ~r/\AReturn AUTO_RTL\z/) end)
  end

  test "the map gets all vehicles, then those that changed, then those that are gone", %{
    console: console
  } do
    put_vehicle(console, "VID-001")
    put_vehicle(console, "VID-002")
    view = open(console)
    assert_push_event(view, "map:vehicles", %{map: "fleet-map", all: true, vehicles: rows})
    assert rows |> decoded() |> Enum.map(&hd/1) |> Enum.sort() == ["VID-001", "VID-002"]
    assert_push_event(view, "map:homes", %{homes: [[47.3975, 8.545]]})

    put_vehicle(console, "VID-001", position: %{lat: 47.5})
    refresh_fleet(view)

    assert_push_event(view, "map:vehicles", %{all: false, vehicles: rows, gone: []})
    assert [["VID-001", 47.5 | _]] = decoded(rows)

    %{key: key} = Aerie.Base.Store.vehicle(console.gateway, "VID-002")
    Aerie.Base.Store.delete_vehicle(console.gateway, key)
    refresh_fleet(view)
    assert_push_event(view, "map:vehicles", %{vehicles: rows, gone: ["VID-002"]})
    assert decoded(rows) == []
    assert shown(view) == ["VID-001"]
  end

  # As the browser reads them.
  defp decoded(rows), do: rows |> JSON.encode!() |> JSON.decode!()

  describe "search, filter and order" do
    setup %{console: console} do
      put_vehicle(console, "VID-2", mode: %{armed: false, in_air: false})
      put_vehicle(console, "VID-10", battery: %{remaining: 0.2})
      put_vehicle(console, "PLANE", [], %{vehicle_type: "plane", autopilot: :px4})
      :ok
    end

    test "are in the address, and come from it", %{console: console} do
      view = open(console)
      assert shown(view) == ["PLANE", "VID-2", "VID-10"]

      view |> form("#fleet-filter", %{q: "vid"}) |> render_change()
      assert_patch(view, "/?q=vid")
      assert shown(view) == ["VID-2", "VID-10"]

      view |> element("button[phx-value-flag=armed]") |> render_click()
      assert_patch(view, "/?q=vid&armed=1")
      assert shown(view) == ["VID-10"]
      assert render(view) =~ "1 of 3 vehicles"

      assert console |> open("/?type=plane") |> shown() == ["PLANE"]
      assert console |> open("/?q=guided+vid-10") |> shown() == ["VID-10"]
      assert console |> open("/?firmware=px4") |> shown() == ["PLANE"]
      assert console |> open("/?sort=battery") |> shown() == ["VID-10", "PLANE", "VID-2"]
    end

    test "a press on a head sorts by it, a second one the other way", %{console: console} do
      view = open(console)
      view |> element("button[phx-value-by=id]") |> render_click()
      assert_patch(view, "/?sort=-id")
      assert shown(view) == ["VID-10", "VID-2", "PLANE"]
      assert render(view) =~ ~s(aria-sort="descending")
    end

    test "that leave nothing say so, with a way back", %{console: console} do
      view = open(console, "/?q=nobody")
      assert render(view) =~ "No vehicle matches"
      view |> element("a", "Show all 3") |> render_click()
      assert length(shown(view)) == 3
    end
  end

  describe "the selection" do
    setup %{console: console} do
      for n <- 1..5, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      {:ok, view: open(console)}
    end

    test "one, one more, a range, all, none", %{view: view} do
      render_hook(view, "select", %{"id" => "V2", "how" => "only"})
      assert selected(view) == ["V2"]
      render_hook(view, "select", %{"id" => "V4", "how" => "range"})
      assert selected(view) == ["V2", "V3", "V4"]
      render_hook(view, "select", %{"id" => "V3", "how" => "toggle"})
      assert selected(view) == ["V2", "V4"]
      assert render(view) =~ "V2, V4"
      render_hook(view, "map_select", %{"map" => "fleet-map", "id" => "V5", "add" => true})
      assert selected(view) == ["V2", "V4", "V5"]
      render_hook(view, "map_select", %{"map" => "fleet-map", "id" => "V1", "add" => false})
      assert selected(view) == ["V1"]
      render_hook(view, "map_box", %{"ids" => ["V2", "V4", "stranger"], "less" => false})
      assert selected(view) == ["V1", "V2", "V4"]
      render_hook(view, "map_box", %{"ids" => ["V1", "V4"], "less" => true})
      assert selected(view) == ["V2"]
      render_hook(view, "all", %{})
      assert length(selected(view)) == 5
      render_hook(view, "none", %{})
      assert selected(view) == []
      refute has_element?(view, "#fleet-actions")
    end

    test "the map shows it", %{view: view} do
      render_hook(view, "select", %{"id" => "V2", "how" => "only"})
      assert view |> element("#fleet-map") |> render() =~ ~s([&quot;V2&quot;])
    end

    test "of a page that is gone comes back", %{view: view} do
      render_hook(view, "again", %{"ids" => ["V2", "V3", "never"]})
      assert selected(view) == ["V2", "V3"]
    end

    test "of somebody who is gone is over, and who was never there cannot be selected", %{
      view: view,
      console: console
    } do
      render_hook(view, "select", %{"id" => "V2", "how" => "only"})
      render_hook(view, "select", %{"id" => "never", "how" => "toggle"})
      assert selected(view) == ["V2"]
      Aerie.Base.Store.delete_vehicle(console.gateway, {"main", 2})
      refresh_fleet(view)
      refute has_element?(view, "#fleet-actions")
    end
  end

  describe "commands for the selection" do
    setup %{console: console} do
      start_operations(console)
      for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      :ok
    end

    test "each vehicle has its own, and its own result", %{console: console} do
      view = open(console)
      for id <- ["V1", "V3"], do: render_hook(view, "select", %{"id" => id, "how" => "toggle"})
      render_hook(view, "command", %{"type" => "rtl", "id" => "web-0001", "ids" => ["V1", "V3"]})

      # This gateway takes no commands, so each is denied, with the reason.
      line = "Return 2: all not allowed: V1, V3 (the gateway takes no commands just now; nothing was sent)"

      eventually(fn ->
        send(view.pid, :console_clock)
        has_element?(view, "#operation-web-0001", line)
      end)

      for id <- ["V1", "V3"],
          do: assert(has_element?(view, "#operation-web-0001 li", ~r/#{id}.*takes no commands just now/s))

      # The same press again is not a second one.
      render_hook(view, "command", %{"type" => "rtl", "id" => "web-0001", "ids" => ["V1", "V3"]})
      assert [%{"id" => "web-0001"}] = Aerie.Fleet.recent_operations(console.gateway)
    end

    test "are not for viewers, whatever their browser sends", %{console: console} do
      view = open(console, "/", :viewer)
      render_hook(view, "select", %{"id" => "V1", "how" => "only"})
      assert has_element?(view, "#fleet-actions", "Viewers watch. Ask an operator or admin for more.")
      assert has_element?(view, "#user-menu summary .badge", "viewer")
      refute console |> open() |> has_element?("#user-menu summary .badge")
      refute has_element?(view, "#fleet-rtl")
      render_hook(view, "command", %{"type" => "rtl", "id" => "web-0001"})
      refute has_element?(view, "#operation-strip")
    end

    test "what is not a command of this page does nothing", %{console: console} do
      view = open(console)
      render_hook(view, "select", %{"id" => "V1", "how" => "only"})
      render_hook(view, "command", %{"type" => "terminate", "id" => "web-0001", "ids" => ["V1"]})
      render_hook(view, "command", %{"type" => "rtl", "id" => "not an id", "ids" => ["V1"]})
      refute has_element?(view, "#operation-strip")
    end
  end

  @tag :tmp_dir
  test "tags of the selected vehicles: common ones are changed, others stay", %{
    console: console,
    tmp_dir: dir
  } do
    gateway = console.gateway
    start_shadow(gateway, dir)
    for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
    :ok = Shadow.tag(gateway, "V1", ["red", " north "])
    :ok = Shadow.tag(gateway, "V2", ["north"])
    view = open(console)
    for id <- ["V1", "V2"], do: render_hook(view, "select", %{"id" => id, "how" => "toggle"})

    view |> element("button", "Tags") |> render_click()
    assert view |> element("#tags-field") |> render() =~ ~s(value="north")
    view |> form("#tags-form", %{tags: String.duplicate("x", 65)}) |> render_submit()
    eventually(fn -> has_element?(view, "#tags-field-errors", "V1: desired.tags") end)
    view |> form("#tags-form", %{tags: "south, spare,"}) |> render_submit()
    eventually(fn -> not has_element?(view, "#tags-form") end)
    assert Shadow.tags(gateway) == %{"V1" => ["red", "south", "spare"], "V2" => ["south", "spare"]}

    view |> form("#fleet-filter", %{tag: "red"}) |> render_change()
    assert shown(view) == ["V1"]
  end

  @tag :tmp_dir
  test "tags of more vehicles than may be changed at once", %{console: console, tmp_dir: dir} do
    start_shadow(console.gateway, dir)
    for n <- 1..60, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
    view = open(console)
    render_click(view, "all")
    view |> element("button", "Tags") |> render_click()
    view |> form("#tags-form", %{tags: "swarm"}) |> render_submit()
    eventually(fn -> map_size(Shadow.tags(console.gateway)) == 60 end)
  end

  test "without a shadow the dialog says why nothing is kept", %{console: console} do
    put_vehicle(console, "V1")
    view = open(console)
    render_hook(view, "select", %{"id" => "V1", "how" => "only"})
    view |> element("button", "Tags") |> render_click()
    view |> form("#tags-form", %{tags: "north"}) |> render_submit()
    eventually(fn -> has_element?(view, "#tags-field-errors", "V1: the shadow") end)
  end

  describe "who is in charge" do
    setup %{console: console} do
      start_operations(console)
      for n <- 1..3, do: put_vehicle(console, "V#{n}", [], %{key: {"main", n}, system_id: n})
      :ok
    end

    test "is in the table and beside the buttons, and follows at once", %{console: console} do
      view = open(console)
      take_charge(console, 1, "olga")
      eventually(fn -> has_element?(view, "#vehicle-V1", "olga") end)
      render_click(view, "all")
      assert has_element?(view, "#fleet-charge", "olga controls V1, free: V2, V3")
      take_charge(console, 2, "operator")
      eventually(fn -> has_element?(view, "#fleet-charge", "you control V2") end)
      refute has_element?(open(console, "/", :viewer), "#fleet-charge")
    end

    test "is taken over with a reason, and released, for those that it concerns", %{console: console} do
      take_charge(console, 1, "olga")
      take_charge(console, 2, "operator")
      view = open(console)
      render_click(view, "all")
      assert has_element?(view, "#fleet-take input[name=reason][required]")

      shown = %{"ids" => ~w(V1 V2 V3), "holders" => %{"V1" => "olga", "V2" => "operator"}}
      take = %{"type" => "take_control", "id" => "press-1", "fields" => %{"reason" => "storm"}}
      # Whoever pressed it saw that nobody was in charge of V1.
      earlier = Map.merge(take, %{shown | "holders" => %{"V2" => "operator"}})
      assert render_hook(view, "command", earlier) =~ "Who is in charge changed; nothing was sent."
      render_hook(view, "command", Map.merge(take, shown))
      for id <- ["V1", "V3"], do: assert(has_element?(view, "#operation-press-1 li", id))
      refute has_element?(view, "#operation-press-1 li", "V2")

      release = %{"type" => "release_control", "id" => "press-2", "fields" => %{}}
      render_hook(view, "command", Map.merge(release, shown))
      assert has_element?(view, "#operation-press-2 li", "V2")
      refute has_element?(view, "#operation-press-2 li", "V1")
    end
  end

  describe "missions on the map" do
    defp told(view),
      do: assert_push_event(view, "map:plans", %{plans: [%{vehicle: "V1"}]}, Aerie.Patience.ms())

    test "are read for the vehicles that somebody switches on, and say why they could not be", %{
      console: console
    } do
      put_vehicle(console, "V1", [mission: %{seq: 2, total: 3}], %{key: {"main", 1}, system_id: 1})
      view = open(console, "/", :viewer)
      render_hook(view, "select", %{"id" => "V1", "how" => "only"})
      view |> element("button", "Missions") |> render_click()
      told(view)
      assert has_element?(view, "button[aria-pressed=true]", "Missions")
      # Nothing here answers for the vehicle.
      eventually(fn -> has_element?(view, ".fleet-plans", "V1: mission:") end)
      view |> element("button", "Missions") |> render_click()
      refute has_element?(view, ".fleet-plans")
    end
  end
end
