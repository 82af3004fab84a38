defmodule Aerie.Console.Pages.Plan.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Missions
  alias Aerie.TransferCase
  alias Protocols.Mission.{Item, Plan}

  @place %{"map" => "plan-map", "lat" => 47.397742, "lon" => 8.545594}

  defp open(console, path \\ "/plan", role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), path)
    view
  end

  defp add(view, north) do
    render_hook(view, "plan_add", %{@place | "lat" => @place["lat"] + north / 111_320})
    view
  end

  # A square around the place, 200 m wide, corner by corner.
  defp zone(view) do
    for {north, east} <- [{1, -1}, {1, 1}, {-1, 1}, {-1, -1}] do
      lat = @place["lat"] + north * 100 / 111_320
      render_hook(view, "plan_add", %{@place | "lat" => lat, "lon" => @place["lon"] + east * 100 / 75_360})
    end

    view |> element("#plan-corners button", "Close the zone") |> render_click()
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

    test "Betaflight has no plans to send or read, iNav has missions only", %{console: console} do
      put_vehicle(console, "BF", [], %{autopilot: :betaflight})
      put_vehicle(console, "IN", [], %{autopilot: :inav})
      {:ok, view, _html} = live(conn(console), "/plan?vehicle=BF")
      render_hook(view, "plan_add", %{"lat" => 47.4, "lon" => 8.5})
      assert has_element?(view, "#plan-gap", "Betaflight has no missions, fences or rally points")
      for label <- ["Read", "Compare"], do: assert(has_element?(view, ".plan-with button[disabled]", label))
      assert has_element?(view, "#plan-upload[disabled]")
      refute has_element?(view, "button", "Remove from vehicle")

      {:ok, view, _html} = live(conn(console), "/plan?vehicle=IN")
      refute has_element?(view, "#plan-gap")
      assert has_element?(view, ".plan-with button:not([disabled])", "Read")
      render_hook(view, "part", %{"part" => "rally"})
      render_hook(view, "plan_add", %{"lat" => 47.4, "lon" => 8.5})
      assert has_element?(view, "#plan-upload[disabled]")
      assert render(view) =~ "iNav has no fences or rally points over MSP"
    end

    test "a fence and rally points", %{console: console} do
      view = open(console)
      view |> element("button", "Fence (0)") |> render_click()
      add(view, 0)
      assert has_element?(view, "#plan-corners button[disabled]", "Close the zone")
      assert view |> element("#plan-problems") |> render() =~ "a zone is not closed yet"
      view |> element("#plan-corners button", "Drop") |> render_click()
      refute has_element?(view, "#plan-problems")
      zone(view)
      refute has_element?(view, "#plan-corners")
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

    test "heights above the sea and what no plan file has room for are shown as that, and kept", %{
      console: console
    } do
      view = open(console)
      other = %Item{command: 5005, frame: 0, params: {300.0, 0.0, 0.0, 0.0}}
      plan = %Plan{fence_others: [other], rally: [{{473_977_420, 85_455_940}, {560.0, 0}}]}
      {:ok, text} = Missions.export(plan, :plan)
      render_hook(view, "import", %{"name" => "a.plan", "text" => text})
      assert view |> element("button", "Fence (0)") |> render_click() =~ "NAV_FENCE_HOME_CIRCLE_INCLUSION"
      assert view |> element("button", "Rally points (1)") |> render_click() =~ "560.0 m above mean sea level"
      view |> element("button.plan-pick") |> render_click()
      view |> form("#plan-rally-0", %{z: "570"}) |> render_change()
      assert %Plan{fence_others: [^other], rally: [{_place, {570.0, 0}}]} = plan_of(view)
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
      # With the zone that is being drawn, and what it is to be.
      render_hook(again, "part", %{"part" => "fence"})
      render_hook(again, "what", %{"shape" => "exclusion polygon"})
      for n <- 1..3, do: add(again, n)

      assert_push_event(again, "plan:keep", %{
        text: text,
        zone: %{shape: "exclusion polygon" = shape, corners: [_, _, _] = corners}
      })

      third = open(console)
      bad = ["x", [1], [91.0, 0.0], nil]
      render_hook(third, "restore", %{"text" => text, "shape" => shape, "corners" => bad ++ corners})
      assert render(third) =~ "Corner 3 of a zone"
      render_hook(third, "close_zone", %{})
      assert [{:exclusion, {:polygon, [_, _, _]}}] = plan_of(third).fence
      render_hook(again, "drop_corners", %{"which" => "all"})
      render_hook(again, "part", %{"part" => "mission"})
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
      [vehicle] = Aerie.Base.Store.vehicles(gateway)
      {:ok, start_console(gateway: gateway) ++ [vehicle: vehicle.id, gateway: gateway]}
    end

    test "a plan is sent, compared and read back", %{console: console, vehicle: vehicle} do
      view = open(console, "/plan?vehicle=#{vehicle}")
      view |> add(0) |> add(150) |> add(300)
      view |> element("button", "Rally points (0)") |> render_click()
      add(view, 20)
      plan = plan_of(view)

      # A press on the plan that was shown before.
      assert render_hook(view, "upload", %{"id" => "web-0000", "shown" => shown(view) <> "0"}) =~
               "nothing was sent"

      assert view |> element("#plan-sends") |> render() =~ "Mission (3 items), Rally points (1 rally point)"
      sent = send_plan(view, "web-0001")
      assert sent =~ "3 items, verified" and sent =~ "1 rally point, verified"
      # No plan without a fence removes the fence.
      assert sent =~ "not sent: the plan has none. What is aboard stays."

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

    for role <- [:operator, :admin] do
      test "sending removes nothing: not by a mission drawn by hand, and not by an empty part (#{role})", c do
        fence(c.gateway, c.vehicle)
        view = open(c.console, "/plan?vehicle=#{c.vehicle}", unquote(role))
        add(view, 0)
        sent = send_plan(view, "web-0001")
        assert sent =~ "1 item, verified" and sent =~ "not sent: the plan has none"
        # Nothing follows where there is nothing to remark.
        refute sent =~ "; but"
        assert {:ok, %{plan: %{fence: [_]}}} = Missions.download(c.gateway, c.vehicle, :fence)

        # What is read and cleared in the drawing is not removed aboard; the rest is as it was read.
        read(view)
        view |> element("button", "Fence (1)") |> render_click()
        render_hook(view, "clear_part", %{})
        refute has_element?(view, "#plan-sends")
        assert has_element?(view, "#plan-upload[disabled]")
        sent = send_plan(view, "web-0002")
        assert sent =~ "not sent: it is as it was read." and sent =~ "not sent: the plan has none"
        refute sent =~ "verified"
        assert {:ok, %{plan: %{fence: [_]}}} = Missions.download(c.gateway, c.vehicle, :fence)
      end
    end

    test "what was read and changed is sent, and nothing else", c do
      fence(c.gateway, c.vehicle)
      view = open(c.console, "/plan?vehicle=#{c.vehicle}")
      read(view)
      add(view, 0)
      assert view |> element("#plan-sends") |> render() =~ "Mission (1 item). What"
      sent = send_plan(view, "web-0001")
      assert sent =~ "1 item, verified" and sent =~ "not sent: it is as it was read."
      # After that the gateway no longer relies on what was read.
      assert view |> add(50) |> send_plan("web-0002") =~ "4 corners, verified"
    end

    test "a part aboard is removed by an act of its own that names it", c do
      fence(c.gateway, c.vehicle)
      view = open(c.console, "/plan?vehicle=#{c.vehicle}", :admin)
      view |> element("button", "Fence (0)") |> render_click()
      view |> element("button", "Remove from vehicle") |> render_click()
      eventually(fn -> over?(view) end)
      button = view |> element("#plan-remove") |> render()
      assert button =~ "Remove the fence aboard #{c.vehicle}: 4 corners"
      [_, digest] = Regex.run(~r/phx-value-digest="(\w+)"/, button)

      # A press names what it removes.
      render_hook(view, "remove_aboard", %{"id" => "web-1", "digest" => "other", "vehicle" => c.vehicle})
      assert render(view) =~ "look again"

      # What came aboard since is not removed.
      press = %{"digest" => digest, "vehicle" => c.vehicle}
      fence(c.gateway, c.vehicle, 5)
      render_hook(view, "remove_aboard", Map.put(press, "id", "web-2"))
      eventually(fn -> over?(view) end)
      assert render(view) =~ "not removed: meanwhile 5 corners on board"

      view |> element("button", "Remove from vehicle") |> render_click()
      eventually(fn -> over?(view) && has_element?(view, "#plan-remove") end)
      [_, digest] = Regex.run(~r/phx-value-digest="(\w+)"/, render(view))
      render_hook(view, "remove_aboard", %{press | "digest" => digest} |> Map.put("id", "web-3"))
      eventually(fn -> over?(view) end)
      assert render(view) =~ "removed: 5 corners"
      assert {:ok, %{plan: %{fence: []}}} = Missions.download(c.gateway, c.vehicle, :fence)
    end

    test "an operator without the permission sees that the fence aboard is not theirs to remove", c do
      fence(c.gateway, c.vehicle)
      view = open(c.console, "/plan?vehicle=#{c.vehicle}")
      view |> element("button", "Fence (0)") |> render_click()
      view |> element("button", "Remove from vehicle") |> render_click()
      eventually(fn -> over?(view) && has_element?(view, "#plan-remove[disabled]") end)
      [_, digest] = Regex.run(~r/phx-value-digest="(\w+)"/, render(view))
      render_hook(view, "remove_aboard", %{"id" => "web-1", "digest" => digest, "vehicle" => c.vehicle})
      eventually(fn -> over?(view) end)
      assert render(view) =~ "denied"
      assert {:ok, %{plan: %{fence: [_]}}} = Missions.download(c.gateway, c.vehicle, :fence)
    end

    test "names a plan that does not fit its own fence, and a vehicle outside of it, before Send", c do
      view = open(c.console, "/plan?vehicle=#{c.vehicle}")
      add(view, 500)
      view |> element("button", "Fence (0)") |> render_click()
      add(view, 0)
      render_hook(view, "upload", %{"id" => "web-0000", "shown" => shown(view)})
      assert render(view) =~ "a zone is not closed yet; nothing was sent"
      view |> element("#plan-corners button", "Drop") |> render_click()
      zone(view)
      view |> element("button", "Rally points (0)") |> render_click()
      add(view, 500)
      problems = view |> element("#plan-problems") |> render()
      assert problems =~ "item 1 is outside the plan&#39;s stay-inside zone 1"
      assert problems =~ "rally point 1 is outside the plan&#39;s stay-inside zone 1"
      assert problems =~ "the vehicle is outside the plan&#39;s stay-inside zone 1"
      # The plan leaves its fence: somebody has to agree, to this plan and no other.
      assert has_element?(view, "#plan-upload[disabled][title*='may leave the fence']")
      render_hook(view, "upload", %{"id" => "web-0000", "shown" => shown(view)})
      assert render(view) =~ "nobody has agreed to that; nothing was sent"
      view |> form("#plan-agree", %{agreed: "true"}) |> render_change()
      assert has_element?(view, "#plan-upload:not([disabled])")
      add(view, 600)
      assert has_element?(view, "#plan-upload[disabled]")
      view |> element("button", "Undo") |> render_click()
      # It stands on the ground: that is told, and does not stop.
      assert send_plan(view, "web-0001") =~ "4 corners, verified; but the vehicle is outside"
    end

    test "a viewer cannot send", %{console: console, vehicle: vehicle} do
      view = open(console, "/plan?vehicle=#{vehicle}", :viewer)
      add(view, 0)
      refute has_element?(view, "#plan-upload")
      render_hook(view, "upload", %{"id" => "web-0001"})
      refute has_element?(view, "#plan-transfer")
    end
  end

  # The vehicle has such a fence.
  defp fence(gateway, vehicle, corners \\ 4) do
    ring =
      Enum.take(
        [
          {473_900_000, 85_400_000},
          {473_900_000, 85_500_000},
          {474_000_000, 85_500_000},
          {474_010_000, 85_450_000},
          {474_000_000, 85_400_000}
        ],
        corners
      )

    plan = %Plan{fence: [{:inclusion, {:polygon, ring}}]}
    assert {:ok, %{status: :completed}} = Missions.upload(gateway, vehicle, :fence, plan)
  end

  defp read(view) do
    view |> element("button", "Read") |> render_click()
    eventually(fn -> over?(view) end)
  end

  defp send_plan(view, id) do
    # Home is outside of the fence aboard.
    render_hook(view, "agree", %{"agreed" => "true", "shown" => shown(view)})
    render_hook(view, "upload", %{"id" => id, "shown" => shown(view)})
    eventually(fn -> over?(view) && view |> element("#plan-transfer") |> render() =~ "Sent to" end)
    view |> element("#plan-transfer") |> render()
  end

  # The plan and the vehicle of the button.
  defp shown(view) do
    [shown] = Regex.run(~r/VID-\d+ \d+/, view |> element("#plan-upload") |> render())
    shown
  end

  defp over?(view), do: has_element?(view, "#plan-transfer button[aria-label=Close]")
end
