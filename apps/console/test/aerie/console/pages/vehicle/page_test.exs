defmodule Aerie.Console.Pages.Vehicle.PageTest do
  @moduledoc "The page of one vehicle. The store is filled by hand, and the test is the vehicle's executor."
  use Aerie.VehiclePageCase, async: true

  alias Aerie.Vehicle.Events.Journal

  @id "VID-007"
  @path "/vehicles/VID-007"

  test "a vehicle that was never heard of", %{console: console} do
    {:ok, _view, html} = live(conn(console), "/vehicles/VID-999")
    assert html =~ "No such vehicle"
  end

  test "each part of the page shows, for each role, with much and with little known", %{console: console} do
    put_link(console, "radio", %{sources: %{{7, 1} => %{received: 95, lost: 5}}})

    for role <- [:viewer, :operator, :admin], part <- ~w(fly commands events charts health links nonsense) do
      assert {:ok, _view, html} = live(conn(console, role), "#{@path}/#{part}")
      assert html =~ "GUIDED"
    end

    put(
      console,
      for(group <- [:position, :attitude, :velocity, :battery, :gps, :mode, :home], do: {group, nil}),
      %{firmware: nil, links: [], autopilot: :generic}
    )

    for part <- ~w(fly commands events charts health links),
        do: assert({:ok, _view, _html} = live(conn(console, :admin), "#{@path}/#{part}"))
  end

  test "a viewer sees no control, and the server refuses their events", %{console: console} do
    view = open(console, :viewer)

    for part <- ["", "/commands?c=land", "/health"] do
      {:ok, view, _html} = live(conn(console, :viewer), @path <> part)
      refute has_element?(view, "button.hold")
      refute has_element?(view, "form[phx-hook=CommandForm]")
    end

    assert give(view, "land", "a") =~ "Viewers can&#39;t do this"

    for {event, value} <- [{"cancel", %{"id" => "a"}}, {"aim", %{}}],
        do: assert(render_hook(view, event, value) =~ "Viewers can")

    render_hook(view, "map_point", %{"lat" => 47.0, "lon" => 8.0})
    refute has_element?(view, "#target-title")
    refute_submitted()
    assert Aerie.Control.Commands.recent(console.gateway, @id) == []
  end

  test "a command's life is seen by all operators, from pending to done", %{console: console} do
    {one, other} = {open(console), open(console, :admin)}
    refute render(one) =~ "Not sent"
    give(one, "rtl", "r1")

    assert_receive {:"$gen_call", from,
                    {:submit, %{id: "r1", type: "rtl", source: "operator"}, desk, _still?}}

    for view <- [one, other],
        do: eventually(fn -> has_element?(view, "#commands-now-r1[data-state=pending]") end)

    send(desk, {:command_progress, "r1", %{"progress" => 0.5, "text" => "turning"}})
    eventually(fn -> has_element?(other, "#commands-now-r1[data-state=progress]", "50 %") end)
    answer(from, "r1", :completed)

    for view <- [one, other],
        do:
          eventually(fn ->
            has_element?(view, "#commands-now-r1[data-state=completed].going", "Returning")
          end)

    assert [%{via: "console", source: "operator"}] = Aerie.Control.Commands.recent(console.gateway, @id)
  end

  test "a reload, a second view, and the same press again send nothing more", %{console: console} do
    view = open(console)
    give(view, "hold", "h1")
    from = executing(%{id: "h1"})
    view = open(console)
    assert has_element?(view, "#commands-now-h1[data-state=pending]")
    give(view, "hold", "h1")
    answer(from, "h1", :completed)
    eventually(fn -> has_element?(view, "#commands-now-h1[data-state=completed]") end)
    give(view, "hold", "h1")
    # The last one is under way again until it has the stored result.
    eventually(fn ->
      match?(
        [%{id: "h1", result: %{status: :completed}}],
        Aerie.Control.Commands.recent(console.gateway, @id)
      )
    end)

    refute_submitted()
  end

  test "refused with the reason; no answer and unknown look like neither", %{console: console} do
    view = open(console)
    put(console, mode: %{armed: true, in_air: false})
    give(view, "takeoff", "high", %{"fields" => %{"altitude" => "200"}})
    eventually(fn -> has_element?(view, "#commands-now-high[data-state=denied].bad", "100") end)

    give(view, "rtl", "u1")
    answer(executing(%{id: "u1"}), "u1", :unknown)

    eventually(fn ->
      has_element?(view, "#commands-now-u1[data-state=unknown].unsure", "may have done it")
    end)

    assert give(view, "takeoff", "t2", %{"fields" => %{"altitude" => "high"}}) =~
             "Not sent: altitude: expected a number"

    assert give(view, "nonsense", "n") =~ "this command does not exist"
    assert render_hook(view, "command", %{"type" => "land"}) =~ "needs an id"
    assert give(view, "land", "not an id!") =~ "expected 1 to 64 letters"
  end

  test "a command that can be cancelled is", %{console: console} do
    put(console, mode: %{armed: false, in_air: false})
    view = open(console, :admin, @path <> "/health")
    give(view, "calibrate", "c1", %{"sensor" => "accelerometer"})
    assert_receive {:"$gen_call", from, {:submit, %{id: "c1"}, desk, _still?}}

    send(
      desk,
      {:command_progress, "c1", %{"progress" => nil, "text" => "Place vehicle level and press any key"}}
    )

    eventually(fn -> has_element?(view, "#calibrations-c1", "Place vehicle level") end)
    task = Task.async(fn -> view |> element("#calibrations-c1 button") |> render_click() end)
    assert_receive {:"$gen_call", canceller, {:cancel, "c1"}}
    GenServer.reply(canceller, :ok)
    Task.await(task, Aerie.Patience.ms())
    answer(from, "c1", :cancelled)
    eventually(fn -> has_element?(view, "#calibrations-c1[data-state=cancelled]") end)
    assert render_hook(view, "cancel", %{"id" => "c1"}) =~ "Not cancelled"
  end

  test "the form of a command: search, fields, what is wrong, the policy's answer, sending", %{
    console: console
  } do
    view = open(console, :operator, @path <> "/commands")
    assert view |> element("#command-search") |> render_change(%{"search" => "go to place"}) =~ "Go to"
    refute has_element?(view, "a.command-link", "Take off")
    view |> element("a.command-link", "Go to") |> render_click()
    assert has_element?(view, "#command-altitude")

    fields = %{"lat" => "47.0001", "lon" => "8.0", "altitude" => "500"}
    assert view |> element("#command-form-goto") |> render_change(fields) =~ "Not allowed"

    assert view |> element("#command-form-goto") |> render_change(%{fields | "altitude" => "50"}) =~
             "Allowed"

    assert give(view, "goto", "g1", %{"fields" => %{fields | "altitude" => "high"}}) =~
             "expected a number from -11000"

    assert has_element?(view, "#command-altitude[aria-invalid]")
    give(view, "goto", "g2", %{"fields" => %{fields | "altitude" => "50"}})

    assert_receive {:"$gen_call", from,
                    {:submit, %{id: "g2", params: %{altitude: 50.0, altitude_reference: "home"}}, _desk,
                     _still?}}

    answer(from, "g2", :completed)
    eventually(fn -> has_element?(view, "#history-g2", "47.00010, 8.00000 at 50 m above home") end)
  end

  test "a gap has its reason among all commands, and no button anywhere", %{console: console} do
    put(console, [], %{autopilot: :px4, vehicle_type: "rover", firmware: "1.18.0"})
    view = open(console, :operator, @path <> "/commands?c=relay")
    assert has_element?(view, ".command-panel .notice", "PX4 has no relays")
    refute has_element?(view, "#command-form-relay")
    refute has_element?(view, "#action-land")
    assert has_element?(view, "#action-hold")
    refute view |> element("a.tab", "Fly") |> render_click() =~ "action-takeoff"

    assert open(console, :operator, @path <> "/commands?c=terminate")
           |> has_element?(".command-panel .notice", "permission terminate")
  end

  test "a click on the map: the policy's answer before anything is sent", %{console: console} do
    view = open(console)
    view |> element("button", "Go to…") |> render_click()
    assert has_element?(view, "#vehicle-map[data-tool=point]")
    render_hook(view, "map_point", %{"map" => "vehicle-map", "lat" => 47.398, "lon" => 8.5456})

    assert_push_event(
      view,
      "map:target",
      %{place: %{lat: 47.398, lon: 8.5456}},
      Aerie.Patience.ms()
    )

    assert has_element?(view, ".goto-panel [data-answer=allow]")
    assert has_element?(view, ".goto-panel", "33 m away")

    assert view |> element("#goto-form") |> render_change(%{"altitude" => "300"}) =~ "Not allowed"
    assert has_element?(view, "#action-goto[disabled]")
    assert view |> element("#goto-form") |> render_change(%{"altitude" => "x"}) =~ "expected a number"
    view |> element("#goto-form") |> render_change(%{"altitude" => "30"})
    refute_submitted()

    give(view, "goto", "g1", %{"fields" => %{"lat" => "47.398", "lon" => "8.5456", "altitude" => "30"}})
    answer(executing(%{id: "g1", params: %{lat: 47.398, altitude: 30.0}}), "g1", :completed)
    refute has_element?(view, ".goto-panel")

    for place <- [%{}, %{"lat" => "x", "lon" => 1}, %{"lat" => 95, "lon" => 0}],
        do: render_hook(view, "map_point", place)

    refute has_element?(view, ".goto-panel")
  end

  test "a place's menu: what the firmware and the user can, and for the others why not", %{console: console} do
    menu = fn view ->
      [json] = Regex.run(~r/data-menu="([^"]*)"/, render(view), capture: :all_but_first)
      json |> String.replace("&quot;", "\"") |> JSON.decode!()
    end

    assert %{"vehicle" => @id, "path" => nil, "items" => items} = menu.(open(console))

    assert [
             {"goto", nil},
             {"land_here", nil},
             {"set_roi", nil},
             {"orbit", "Not available: only ArduPlane" <> _},
             home
           ] =
             for(item <- items, do: {item["act"], item["refusal"]})

    # In the air, where it would return to protects it.
    assert {"set_home", "Not allowed: set_home needs the permission protection" <> _} = home

    assert %{"items" => [], "note" => "viewer can only watch this vehicle."} = menu.(open(console, :viewer))
    land = fn -> Enum.find(menu.(open(console))["items"], &(&1["act"] == "land_here"))["refusal"] end
    put(console, mode: %{in_air: false})
    assert land.() == "Not now: it is on the ground"
    put(console, [], %{vehicle_type: "plane"})
    assert land.() =~ "Not available: ArduPlane lands by"
    put(console, [], %{autopilot: :px4, vehicle_type: "plane"})
    assert land.() =~ "Not now: what has wings circles"
    put(console, [], %{autopilot: :betaflight})
    assert Enum.all?(menu.(open(console))["items"], &(&1["refusal"] =~ "Not available"))
  end

  test "each act of a place has its card, and nothing else makes one", %{console: console} do
    home = %{lat: 47.397, lon: 8.5456, alt_msl: 488.0}
    put(console, [home: home], %{autopilot: :px4})
    view = open(console)
    place = %{"lat" => 47.398, "lon" => 8.5456}

    for {act, title, fields} <- [
          {"goto", "Go to a place", %{"altitude" => "20", "speed" => ""}},
          {"land_here", "Land at a place", %{"altitude" => "20", "speed" => ""}},
          {"set_roi", "Look at a place", %{"altitude" => "0"}},
          {"orbit", "Circle around a place", %{"radius" => "20", "altitude" => "20", "speed" => ""}},
          {"set_home", "Set home at a place", %{"altitude_msl" => "488.0"}}
        ] do
      if act == "set_home", do: put(console, [home: home, mode: %{in_air: false}], %{autopilot: :px4})
      render_hook(view, "map_guided", Map.put(place, "act", act))
      assert has_element?(view, "#target-title", title)
      for {name, text} <- fields, do: assert(has_element?(view, "##{act}-#{name}[value='#{text}']"))
      assert has_element?(view, "#action-#{act}:not([disabled])")
    end

    give(view, "set_home", "h1", %{"fields" => Map.merge(stringed(place), %{"altitude_msl" => "488.0"})})
    answer(executing(%{id: "h1", params: %{lat: 47.398, altitude_msl: 488.0}}), "h1", :completed)
    refute has_element?(view, ".goto-panel")

    for act <- ["land_now", "arm", nil, %{}], do: render_hook(view, "map_guided", Map.put(place, "act", act))
    refute has_element?(view, ".goto-panel")
    viewer = open(console, :viewer)
    assert render_hook(viewer, "map_guided", Map.put(place, "act", "goto")) =~ "Viewers can"
    refute has_element?(viewer, ".goto-panel")
  end

  test "Land here is an operation for the vehicle of the press, which goes there first", %{console: console} do
    start_operations(console)
    # At the place already, and still.
    place = %{"lat" => "47.397", "lon" => "8.5456", "altitude" => "25"}
    put(console, position: %{lat: 47.397, lon: 8.5456}, velocity: %{groundspeed: 0.1})
    view = open(console)
    render_hook(view, "map_guided", %{"act" => "land_here", "lat" => 47.397, "lon" => 8.5456})
    assert has_element?(view, "#action-land_here[phx-value-vehicle=#{@id}]:not([disabled])")

    press = fn view, id, more ->
      give(view, "land_here", id, Map.merge(%{"vehicle" => @id, "fields" => place}, more))
    end

    assert press.(view, "l0", %{"vehicle" => "VID-008"}) =~ "Not sent"
    assert press.(view, "l0", %{"fields" => Map.delete(place, "altitude")}) =~ "Not sent: altitude"
    assert press.(view, "l 0", %{}) =~ "Not sent: id"
    assert press.(open(console, :viewer), "l0", %{}) =~ "Viewers can"
    put(console, mode: %{in_air: false})
    assert press.(view, "l0", %{}) =~ "Not sent: it is on the ground"
    assert Aerie.Fleet.recent_operations(console.gateway) == []

    put(console, position: %{lat: 47.397, lon: 8.5456}, velocity: %{groundspeed: 0.1})
    press.(view, "l1", %{})
    refute has_element?(view, ".goto-panel")
    # The same press again is the same operation.
    press.(view, "l1", %{})
    goto = executing(%{type: "goto", params: %{lat: 47.397, altitude: 25.0}})
    {:ok, %{"source" => "operator", "name" => "Land here"}} = Aerie.Fleet.operation(console.gateway, "l1")
    answer(goto, command_id(console, "goto"), :completed)
    land = executing(%{type: "land"})
    answer(land, command_id(console, "land"), :completed)
    eventually(fn -> match?({:ok, %{"state" => "done"}}, Aerie.Fleet.operation(console.gateway, "l1")) end)
    assert [_one] = Aerie.Fleet.recent_operations(console.gateway)
  end

  defp command_id(console, type),
    do: Enum.find(Aerie.Control.Commands.recent(console.gateway, @id), &(&1.type == type)).id

  defp stringed(place), do: Map.new(place, fn {name, number} -> {name, to_string(number)} end)

  test "an address that names a place prepares it once; one that is wrong prepares nothing", %{
    console: console
  } do
    {:ok, view, _html} = live(conn(console), @path <> "?act=orbit&lat=47.398&lon=8.5456")
    eventually(fn -> has_element?(view, "#target-title", "Circle") end)
    assert_patch(view, @path, Aerie.Patience.ms())
    assert has_element?(view, ".goto-panel [data-answer=deny]", "only ArduPlane")

    for query <- ["act=goto", "act=goto&lat=x&lon=1", "act=goto&lat=91&lon=1"] do
      {:ok, view, _html} = live(conn(console), @path <> "?" <> query)
      assert_patch(view, @path, Aerie.Patience.ms())
      refute has_element?(view, ".goto-panel")
    end
  end

  @tag :chromium
  test "in a browser: the menu of a place by mouse, keyboard and touch; a box selects", %{console: console} do
    put_vehicle(console, "VID-008", [position: %{lat: 47.3974, lon: 8.546}], %{key: {"main", 8}, system_id: 8})

    browse(console, "guided.mjs")
    executing(%{type: "set_roi"})
  end

  test "a lost vehicle is plainly lost, and old values have their age", %{console: console} do
    # In minutes, which a busy machine does not miss.
    put(console, [], %{status: :lost, last_heard: System.os_time(:microsecond) - 34 * 60_000_000})
    {:ok, view, html} = live(conn(console), @path)
    assert html =~ "Vehicle lost."
    assert html =~ "34 min"
    assert html =~ "Commands are refused until it is heard."
    assert has_element?(view, "#instruments[data-status=lost]")

    at = System.os_time(:microsecond) - 90 * 60_000_000

    put(console, [], %{
      groups: %{battery: %{at: at, time_boot_ms: 1, data: %{voltage: 12.34, remaining: 0.5}}}
    })

    eventually(fn -> has_element?(view, "#battery .age.old", "90 min") end)
    assert has_element?(view, "#battery", "12.34 V")
    assert has_element?(view, "#gps", "Not reported by the vehicle")
  end

  test "what happens stands on the time line; it can be filtered and paused", %{console: console} do
    view = open(console, :viewer, @path <> "/events")
    assert render(view) =~ "No events yet"
    happened(console, "statustext", %{"text" => "EKF3 IMU0 is using GPS", "severity" => 6}, 1)
    happened(console, "failsafe", %{"type" => "battery", "action" => "rtl"}, 2)
    eventually(fn -> has_element?(view, "#events .event.bad", "failsafe: battery → rtl") end)
    assert has_element?(view, "#events .event", "EKF3")

    refute view |> element("#events-filter") |> render_change(%{"level" => "error", "search" => ""}) =~ "EKF3"

    assert view |> element("#events-filter") |> render_change(%{"level" => "all", "search" => "ekf"}) =~
             "EKF3"

    view |> element("#events-filter") |> render_change(%{"level" => "nonsense", "search" => ""})
    view |> element("button", "Pause") |> render_click()
    happened(console, "statustext", %{"text" => "later", "severity" => 6}, 3)
    eventually(fn -> length(Journal.recent(console.gateway, @id)) == 3 end)
    refute render(view) =~ "later"
    assert view |> element("button", "Resume") |> render_click() =~ "later"
  end

  test "charts: chosen by the address, samples as events", %{console: console} do
    view = open(console, :viewer, @path <> "/charts")
    view |> element("#chart-add") |> render_change(%{"key" => "battery.voltage"})
    assert_patch(view, @path <> "/charts?f=battery.voltage", Aerie.Patience.ms())
    put(console, battery: %{voltage: 21.5})

    assert_push_event(
      view,
      "chart",
      %{chart: "charts", values: %{"battery.voltage" => 21.5}},
      Aerie.Patience.ms()
    )

    view |> element("#chart-add") |> render_change(%{"key" => "no.such"})
    assert has_element?(view, ".chip", "Battery voltage")
    view |> element(".chip a") |> render_click()
    assert render(view) =~ "No field chosen"
  end

  test "charts of messages' fields, which are heard only meanwhile", %{console: console} do
    put_link(console, "radio")

    view =
      open(
        console,
        :viewer,
        @path <> "/charts?f=ATTITUDE.roll,BATTERY_STATUS.voltages.1,NO_SUCH.field,battery.voltage"
      )

    for label <- ["ATTITUDE roll", "BATTERY_STATUS voltages 1", "Battery voltage"],
        do: assert(has_element?(view, ".chip", label))

    refute render(view) =~ "NO_SUCH"

    heard(console, %MavCodec.Messages.Attitude{time_boot_ms: 5, roll: 0.5})
    eventually(fn -> has_element?(view, "#chart-message option", "ATTITUDE") end)

    assert_push_event(
      view,
      "chart",
      %{
        values: %{"ATTITUDE.roll" => 0.5, "BATTERY_STATUS.voltages.1" => nil, "battery.voltage" => 22.8}
      },
      Aerie.Patience.ms()
    )

    html =
      view
      |> element("#chart-add")
      |> render_change(%{"message" => "ATTITUDE", "key" => ""})

    assert html =~ "ATTITUDE pitchspeed (rad/s)"
    view |> element("a.tab", "Links") |> render_click()
    eventually(fn -> Aerie.Fleet.Inspector.rows(console.gateway) == [] end)
  end

  defp heard(console, message) do
    bytes = MavCodec.encode(message, system: 7, component: 1)

    {frames, _parser} =
      MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, System.os_time(:microsecond) + ahead_us())

    MavRouter.Recorder.link_frames(console.gateway, "radio", frames)
  end

  test "instruments and the map get the vehicle as it changes", %{console: console} do
    view = open(console, :viewer)

    assert_push_event(
      view,
      "instruments",
      %{vehicle: @id, roll: 1.5, speed: 3.0},
      Aerie.Patience.ms()
    )

    assert_push_event(
      view,
      "map:vehicles",
      %{map: "vehicle-map", vehicles: [[@id | _row]]},
      Aerie.Patience.ms()
    )

    assert_push_event(view, "map:homes", %{homes: [[47.3975, 8.545]]}, Aerie.Patience.ms())
    put(console, attitude: %{roll: -20.0})
    assert_push_event(view, "instruments", %{roll: -20.0}, Aerie.Patience.ms())
  end

  test "links of this vehicle, with loss", %{console: console} do
    put_link(console, "radio", %{
      sources: %{{7, 1} => %{received: 95, lost: 5}, {9, 1} => %{received: 1, lost: 99}}
    })

    put_link(console, "other")
    view = open(console, :viewer, @path <> "/links")
    assert has_element?(view, "#link-radio", "5.00 % (5)")
    refute has_element?(view, "#link-other")
  end
end
