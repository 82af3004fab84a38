defmodule Aerie.Console.Pages.Vehicle.ControlTest do
  @moduledoc "What a vehicle's page offers by the vehicle's state, and how it tells what becomes of it. As `PageTest`, with a store that is filled by hand."
  use Aerie.VehiclePageCase, async: true

  alias Aerie.Base.PubSub
  alias Aerie.Console.Commands.Courses
  alias Aerie.Control.Commands

  @path "/vehicles/VID-007"

  test "where it is sent stays on the map until it is there (F7)", %{console: console} do
    view = open(console)
    give(view, "goto", "g1", %{"fields" => %{"lat" => "47.3987", "lon" => "8.5456", "altitude" => "20"}})
    answer(executing(%{id: "g1"}), "g1", :completed)
    eventually(fn -> has_element?(view, "#commands-now-g1.going[data-state=completed]", "On its way") end)
    assert has_element?(view, "#commands-now-g1", "111 m to go, 37 s")
    marked = %{map: "vehicle-map", place: %{lat: 47.3987, lon: 8.5456, text: "on its way"}}
    assert_push_event(view, "map:target", ^marked, Aerie.Patience.ms())

    # A page that is opened later shows the same.
    assert_push_event(open(console, :viewer), "map:target", ^marked, Aerie.Patience.ms())

    put(console, position: %{lat: 47.3987})
    eventually(fn -> has_element?(view, "#commands-now-g1.good", "Arrived") end)
    assert_push_event(view, "map:target", %{place: nil}, Aerie.Patience.ms())
  end

  test "what was reached is shown so by a page that is loaded later, even if none was open", %{
    console: console
  } do
    away = %{"lat" => 47.3987, "lon" => 8.5456, "altitude" => 20}

    # Each with where it begins, and what shows that it was reached.
    for {type, params, begins, there, label} <- [
          {"takeoff", %{"altitude" => 40}, %{alt_rel: 1.0}, %{alt_rel: 40.2}, "At height"},
          {"set_altitude", %{"altitude" => 60}, %{alt_rel: 40.2}, %{alt_rel: 59.0}, "At height"},
          {"goto", away, %{lat: 47.3977, alt_rel: 20.0}, %{lat: 47.3987, lon: 8.5456, alt_rel: 20.0},
           "Arrived"}
        ] do
      put(console, position: begins, mode: %{armed: true, in_air: type != "takeoff"})
      complete(console, type, params)
      # A command that has ended when it is first looked at gives no notice.
      assert %{^type => %{stage: :going}} = Courses.of(console.gateway, "VID-007")
      :ok = PubSub.subscribe(console.gateway, {:commands, "VID-007"})
      put(console, position: there, mode: %{armed: true, in_air: true})
      assert_receive {:fleet, {:commands, "VID-007"}, ^type}
      :ok = PubSub.unsubscribe(console.gateway, {:commands, "VID-007"})

      # Then it is sent home, and is where it was before.
      complete(console, "rtl", %{}, "rtl-#{type}")
      put(console, position: begins)

      for _reload <- 1..2 do
        view = open(console, :viewer, @path <> "/commands")
        assert {type, has_element?(view, "#history-#{type}.good", label)} == {type, true}
        refute view |> element("#history-#{type}") |> render() =~ "Ended"
      end
    end
  end

  # Somebody else's command, completed by the vehicle.
  defp complete(console, type, params, id \\ nil) do
    id = id || type
    envelope = %{"id" => id, "vehicle" => "VID-007", "type" => type, "params" => params}
    admin = %{name: "ann", role: :admin, permissions: []}
    {:pending, ^id} = Commands.submit(console.gateway, envelope, admin, via: "rest", wait_ms: 0)
    answer(executing(%{id: id}), id, :completed)
    eventually(fn -> match?({:ok, %{status: :completed}}, Commands.state(console.gateway, "VID-007", id)) end)
  end

  test "take off is offered on the ground, and is the first choice only there (F6)", %{console: console} do
    # In the air it keeps its place, and refuses the hand and the key.
    assert console
           |> open()
           |> has_element?("#action-takeoff[data-refusal='It is in the air.'][data-shortcut=T]")

    put(console, mode: %{armed: true, in_air: false})
    assert console |> open() |> has_element?("#action-takeoff.primary")
    put(console, mode: %{armed: true, in_air: nil})
    assert console |> open() |> has_element?("#action-takeoff.plain")
  end

  test "what the policy allows and the vehicle's state speaks against (F12)", %{console: console} do
    obstacles = fn type ->
      {:ok, view, _html} = live(conn(console), @path <> "/commands?c=#{type}")
      view |> element("#command-form-#{type}") |> render_change(%{"altitude" => "10"})
    end

    assert obstacles.("takeoff") =~ ~r"it is in the air"i
    put(console, mode: %{failsafe: true, system_status: "CRITICAL"}, battery: %{charge_state: "CRITICAL"})
    html = obstacles.("mission_start")
    for words <- ["Allowed", "Battery critical.", "Failsafe active"], do: assert(html =~ words)
    refute obstacles.("land") =~ "obstacles"
    put(console, mission: %{total: 0})
    assert obstacles.("mission_start") =~ "It has no mission."
    put(console, mode: %{armed: false, in_air: false, failsafe: false})
    assert obstacles.("takeoff") =~ ~r"it is not armed"i
  end

  test "a vehicle with a mission: the current item, start, pause, resume; its route is read when it flies it (F11)",
       %{console: console} do
    refute console |> open() |> has_element?("#mission")
    put(console, mission: %{seq: 3, total: 7})
    view = open(console)
    assert has_element?(view, "#mission", "Item 3 of 7")
    refused = &has_element?(view, "#action-#{&1}[data-refusal]")
    for name <- ~w(mission_start mission_pause resume), do: assert(has_element?(view, "#action-#{name}"))
    assert Enum.filter(~w(mission_start mission_pause resume), refused) == []
    assert has_element?(view, "#mission button[phx-click=route][aria-pressed=false]")
    put(console, mission: %{seq: 3, total: 7}, mode: %{mode: "AUTO"})
    eventually(fn -> has_element?(view, "#mission button[phx-click=route][aria-pressed=true]") end)
    assert Enum.filter(~w(mission_start mission_pause resume), refused) == ~w(mission_start resume)
    view |> element("#mission button[phx-click=route]") |> render_click()
    assert has_element?(view, "#mission button[phx-click=route][aria-pressed=false]")
    refute console |> open(:viewer) |> has_element?("#mission .hold")
  end

  test "a mode in which the firmware does not arm offers the one to be set first", %{console: console} do
    put(console, mode: %{armed: false, in_air: false, mode: "LAND"})
    view = open(console)

    assert has_element?(
             view,
             "#action-arm[phx-value-type=set_mode][phx-value-mode=GUIDED]",
             "Set GUIDED first"
           )

    assert has_element?(view, "#action-arm[data-key-refusal='It cannot be armed in LAND. Set GUIDED first.']")
    assert has_element?(view, "#action-arm-other[phx-value-type=arm]")
    give(view, "set_mode", "m1", %{"mode" => "GUIDED"})
    from = executing(%{type: "set_mode", params: %{mode: "GUIDED"}, id: "m1"})
    answer(from, "m1", :completed)

    put(console, mode: %{armed: false, in_air: false, mode: "GUIDED"})
    send(view.pid, :refresh)
    # The same button is the next step, so the keyboard's focus stays on it.
    assert has_element?(
             view,
             "#action-arm[phx-value-type=arm][data-shortcut=A]:not([data-key-refusal])",
             "Arm"
           )

    refute has_element?(view, "#action-arm-other")
    put(console, mode: %{armed: true, in_air: false, mode: "GUIDED"})
    send(view.pid, :refresh)
    assert has_element?(view, "#action-arm[phx-value-type=disarm][data-key-refusal='It is armed already.']")
    put(console, mode: %{armed: nil, in_air: false, mode: "GUIDED"})
    send(view.pid, :refresh)
    assert has_element?(view, "#action-arm[phx-value-type=arm]")
    assert has_element?(view, "#action-arm-other[phx-value-type=disarm]")
    put(console, mode: %{armed: false, mode: "LAND"})
    refute open(console, :viewer) |> has_element?("#action-arm")
  end

  test "the workshop is not offered in the air, nor where that is not known", %{console: console} do
    calibrations = ~w(#calibrate-gyro #calibrate-esc #calibrate-compass_motor #lies-level #calibrate-accept)

    for mode <- [
          %{armed: true, in_air: true},
          %{armed: true, in_air: false},
          %{armed: false, in_air: true},
          %{armed: nil, in_air: nil},
          %{armed: false, in_air: nil}
        ] do
      put(console, mode: mode)
      view = open(console, :admin, @path <> "/health")
      for button <- calibrations, do: refute(has_element?(view, button))
      assert has_element?(view, "#calibration", "is allowed only while the vehicle is")
      assert has_element?(view, "#calibrate-cancel")

      for type <- ~w(reboot reset_params) do
        view = open(console, :admin, @path <> "/commands?c=#{type}")
        assert has_element?(view, "#command-send-#{type}[disabled]")
        assert has_element?(view, ".policy-answer.bad", "#{type} is allowed only while the vehicle is")
      end
    end

    # A press that was made before it took off.
    view = open(console, :admin)
    give(view, "calibrate", "c1", %{"sensor" => "gyro"})
    eventually(fn -> has_element?(view, "#commands-now-c1[data-state=denied]") end)

    put(console, mode: %{armed: false, in_air: false})
    view = open(console, :admin, @path <> "/health")
    for button <- calibrations, do: assert(has_element?(view, button))

    assert open(console, :admin, @path <> "/commands?c=reboot")
           |> has_element?("#command-send-reboot:not([disabled])")
  end

  test "a single click commands nothing but questions and cameras", %{console: console} do
    put(console, mode: %{armed: false, in_air: false})

    for {type, held?} <-
          [reset_params: true, set_geofence: true, set_home: true, gripper: true, disarm: true] ++
            [request_message: false, camera_photo: false, prearm_check: false] do
      view = open(console, :admin, @path <> "/commands?c=#{type}")
      assert {type, has_element?(view, "#command-form-#{type} .hold")} == {type, held?}
      assert {type, has_element?(view, "#command-form-#{type} [type=submit]")} == {type, not held?}
    end
  end

  test "what keeps it from arming", %{console: console} do
    put(console,
      mode: %{armed: false},
      health: %{ready_to_arm: false, unhealthy: ["3d_mag"], vibration: [1.0, 2.0, 3.0]}
    )

    view = open(console, :viewer, @path <> "/health")
    assert has_element?(view, "#arming", "not ready to arm")
    assert has_element?(view, "#arming", "3D mag is unhealthy")
    happened(console, "statustext", %{"text" => "PreArm: Compass not calibrated", "severity" => 2}, 1)
    eventually(fn -> has_element?(view, "#arming", "Compass not calibrated") end)
  end

  test "one operator is in charge; another one takes over with a reason", %{console: console} do
    {one, other} = {open(console), open(console, :admin)}
    assert has_element?(one, "#charge.free", "Control: free")
    give(one, "take_control", "t1")

    eventually(fn ->
      has_element?(one, "#charge.own") and has_element?(other, "#charge.other", "Control: operator, since")
    end)

    give(other, "set_mode", "m1", %{"mode" => "GUIDED"})
    eventually(fn -> has_element?(other, "#commands-now-m1[data-state=denied]", "operator is in charge") end)
    # Whoever pressed it saw that nobody was in charge.
    assert give(other, "take_control", "t0", %{"fields" => %{"reason" => "it is free"}}) =~
             "Who is in charge changed; nothing was sent."

    give(other, "take_control", "t2", %{"holder" => "operator"})
    eventually(fn -> has_element?(other, "#commands-now-t2[data-state=denied]", "needs a reason") end)

    give(other, "take_control", "t3", %{
      "fields" => %{"reason" => "battery of the tablet"},
      "holder" => "operator"
    })

    eventually(fn -> has_element?(one, "#charge.other", "battery of the tablet") end)
    refute open(console, :viewer) |> has_element?("#charge form")
  end
end
