defmodule FleetWeb.Console.Plan.PageTest do
  use FleetWeb.ConsoleCase, async: true

  alias Aerie.{Missions, TransferCase}
  alias Aerie.Mission.Plan

  @place %{"map" => "plan-map", "lat" => 47.397742, "lon" => 8.545594}

  defp open(console, path \\ "/plan", role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), path)
    view
  end

  defp add(view, north) do
    render_hook(view, "plan_add", %{@place | "lat" => @place["lat"] + north / 111_320})
    view
  end

  defp plan_of(view) do
    render_hook(view, "export", %{"format" => "plan"})
    assert_push_event(view, "plan:file", %{name: "aerie.plan", text: text})
    {:ok, plan} = Missions.import(text, :plan)
    plan
  end

  describe "without a vehicle" do
    setup do: {:ok, start_console()}

    test "a mission is drawn, changed in its fields, undone and written to a file", %{console: console} do
      view = open(console)
      assert render(view) =~ "No mission yet"
      view |> form("#plan-what", %{command: "22"}) |> render_change()
      add(view, 0)
      view |> form("#plan-what", %{command: "16"}) |> render_change()
      view |> form("#plan-altitude", %{altitude: "40"}) |> render_change()
      view |> add(200) |> add(400)
      view |> form("#plan-action", %{command: "20"}) |> render_submit()
      assert_push_event(view, "map:plan", %{plan: %{items: [_, _, _, %{lat: nil}]}})
      assert has_element?(view, "#plan-profile")

      view |> element("#plan-items button[phx-value-index='1']", "Waypoint") |> render_click()
      view |> form("#plan-item-1", %{z: "55.5", p1: "12"}) |> render_change()
      plan = plan_of(view)
      assert Enum.map(plan.items, &{&1.command, &1.z}) == [{22, 30.0}, {16, 55.5}, {16, 40.0}, {20, 0.0}]
      assert Enum.at(plan.items, 1).params == {12.0, 0.0, 0.0, 0.0}

      render_hook(view, "plan_move", %{
        "map" => "plan-map",
        "part" => "mission",
        "index" => 1,
        "lat" => 47.5,
        "lon" => 8.5
      })

      assert %{x: 475_000_000, y: 85_000_000} = view |> plan_of() |> Map.fetch!(:items) |> Enum.at(1)
      view |> element("button", "Undo") |> render_click()
      assert plan_of(view).items == plan.items
      view |> element("button[aria-label='Remove item 1']") |> render_click()
      assert length(plan_of(view).items) == 3
    end

    test "a fence and rally points", %{console: console} do
      view = open(console)
      view |> element("button", "Fence (0)") |> render_click()
      add(view, 0)
      view |> form("#plan-shape", %{shape: "exclusion circle"}) |> render_change()
      add(view, 50)
      view |> form("#plan-zone-1", %{radius: "25"}) |> render_change()
      render_hook(view, "plan_insert", Map.merge(@place, %{"part" => "fence", "index" => 0, "corner" => 1}))
      view |> element("button", "Rally points (0)") |> render_click()
      add(view, 10)

      assert %Plan{
               fence: [{:inclusion, {:polygon, [_, _, _, _, _]}}, {:exclusion, {:circle, _, 25.0}}],
               rally: [{_, 30.0}]
             } = plan_of(view)
    end

    test "what is wrong is shown, and what a browser should not send does nothing", %{console: console} do
      view = open(console)
      view |> add(0) |> form("#plan-action", %{command: "177"}) |> render_submit()
      view |> form("#plan-item-1", %{p1: "9"}) |> render_change()
      assert render(view) =~ "item 2 jumps to an item that does not exist"
      view |> form("#plan-item-1", %{p1: "1"}) |> render_change()
      refute has_element?(view, "#plan-problems")
      render_hook(view, "plan_add", %{"lat" => 99, "lon" => "x"})
      assert render(view) =~ "expected a latitude"

      for {event, value} <- [
            {"plan_move", %{"part" => "nothing", "index" => 0}},
            {"plan_pick", %{"part" => "mission", "index" => -1}},
            {"remove", %{"part" => "mission", "index" => "99"}},
            {"shift", %{"index" => "0", "by" => "7"}},
            {"action", %{"command" => "1"}},
            {"set", %{"part" => "mission", "index" => "x"}},
            {"part", %{"part" => "x"}},
            {"upload", %{"id" => "web-1"}}
          ],
          do: render_hook(view, event, value)

      assert length(plan_of(view).items) == 2
    end

    test "files are opened, or refused with the reason; a draft outlives its page", %{console: console} do
      view = open(console, "/plan", :viewer)
      render_hook(view, "import", %{"name" => "a.plan", "text" => "{}"})
      assert render(view) =~ "a.plan: fileType: expected"

      waypoints =
        "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.3\t8.5\t400\t1\n1\t0\t3\t16\t0\t0\t0\t0\t47.4\t8.6\t30\t1\n"

      render_hook(view, "import", %{"name" => "a.waypoints", "text" => waypoints})
      assert [%{x: 474_000_000}] = plan_of(view).items
      assert_push_event(view, "plan:keep", %{text: text})

      again = open(console)
      render_hook(again, "restore", %{"text" => text})
      assert [%{x: 474_000_000}] = plan_of(again).items
      # Not over what was drawn since.
      again |> add(0) |> render_hook("restore", %{"text" => text})
      assert length(plan_of(again).items) == 2
    end
  end

  describe "with a vehicle" do
    @describetag :tmp_dir

    setup %{tmp_dir: dir} do
      {gateway, port} = TransferCase.start(dir)
      TransferCase.fly(gateway, port, [])
      [vehicle] = Aerie.Store.vehicles(gateway)
      {:ok, start_console(gateway: gateway) ++ [vehicle: vehicle.id, gateway: gateway]}
    end

    test "a plan is sent, compared and read back", %{console: console, vehicle: vehicle} do
      view = open(console, "/plan?vehicle=#{vehicle}")
      view |> add(0) |> add(150) |> add(300)
      view |> element("button", "Rally points (0)") |> render_click()
      add(view, 20)
      plan = plan_of(view)

      render_hook(view, "upload", %{"id" => "web-0001"})
      eventually(fn -> view |> render() |> String.contains?("on board") && over?(view) end)
      sent = view |> element("#plan-transfer") |> render()
      assert sent |> String.split("on board, and read back") |> length() == 3
      # An operator does not remove the fence by a plan that has none.
      assert sent =~ "not sent: the plan has no fence"

      view |> element("button", "Compare") |> render_click()
      eventually(fn -> view |> render() |> String.contains?("the same on board") && over?(view) end)

      render_hook(view, "clear_part", %{})
      view |> element("button", "Mission (3)") |> render_click()
      render_hook(view, "clear_part", %{})
      view |> element("button", "Compare") |> render_click()
      eventually(fn -> view |> render() |> String.contains?("differs") && over?(view) end)

      view |> element("button", "Read") |> render_click()
      eventually(fn -> over?(view) && length(plan_of(view).items) == 3 end)
      read = plan_of(view)

      assert Enum.map(read.items, &{&1.command, &1.x, &1.y, &1.z}) ==
               Enum.map(plan.items, &{&1.command, &1.x, &1.y, &1.z})

      assert read.rally == plan.rally
    end

    test "a viewer cannot send", %{console: console, vehicle: vehicle} do
      view = open(console, "/plan?vehicle=#{vehicle}", :viewer)
      add(view, 0)
      refute has_element?(view, "#plan-upload")
      render_hook(view, "upload", %{"id" => "web-0001"})
      refute has_element?(view, "#plan-transfer")
    end
  end

  defp over?(view), do: has_element?(view, "#plan-transfer button[aria-label=Close]")
end
