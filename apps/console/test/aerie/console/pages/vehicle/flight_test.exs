defmodule Aerie.Console.Pages.Vehicle.FlightTest do
  @moduledoc "Simulated vehicles behind real UDP, flown by the page: through the test's client, and in a browser."
  use Aerie.ConsoleCase, async: true

  import Aerie.TransferCase, only: [fly: 3]

  alias Aerie.Base.Store
  alias Aerie.CommandCase

  @moduletag :tmp_dir
  @moduletag :capture_log
  @path "/vehicles/VID-001"

  # Fast, and armed on the ground until it is told otherwise.
  defp start(dir, firmware) do
    {gateway, port} = Aerie.TransferCase.start(dir, %{max_altitude: 100})
    [console: console] = start_console(gateway: gateway)
    params = %{ardupilot: %{"DISARM_DELAY" => 0}, px4: %{"COM_DISARM_PRFLT" => 0}}[firmware]
    sim = fly(gateway, port, firmware: firmware, speed: 5.0, params: params)
    SimVehicle.await(sim, & &1.ready)
    eventually(fn -> data(gateway, :home)[:alt_msl] && data(gateway, :mode)[:in_air] == false end)
    {console, sim}
  end

  defp data(gateway, group), do: get_in(Store.vehicle(gateway, "VID-001").groups, [group, :data]) || %{}

  defp give(view, type, fields \\ %{}) do
    id = Aerie.Vehicle.Command.id()
    render_hook(view, "command", %{"id" => id, "type" => type, "fields" => fields})

    eventually(fn ->
      has_element?(view, "#commands-now-#{id}") and not has_element?(view, "#commands-now-#{id}.busy")
    end)

    view |> element("#commands-now-#{id}") |> render()
  end

  for {firmware, mode} <- [ardupilot: "GUIDED", px4: "AUTO_LOITER"] do
    test "#{firmware}: arm, take off, go to a place, land", %{tmp_dir: dir} do
      {console, sim} = start(dir, unquote(firmware))
      {:ok, view, _html} = live(conn(console, :operator), @path)

      assert give(view, "set_mode", %{"mode" => unquote(mode)}) =~ "Done"
      assert give(view, "arm") =~ "Done"
      eventually(fn -> has_element?(view, ".vehicle-armed", "ARMED") end)
      assert give(view, "takeoff", %{"altitude" => "150"}) =~ "Not allowed"
      assert give(view, "takeoff", %{"altitude" => "10"}) =~ ~r/Climbing|At height/
      SimVehicle.await(sim, &(&1.alt_rel > 8))
      eventually(fn -> has_element?(view, ".vehicle-air", "Flying") end)
      eventually(fn -> has_element?(view, "#latest", "took off") end)

      %{lat: lat, lon: lon} = data(console.gateway, :position)
      render_hook(view, "map_point", %{"lat" => lat + 0.0003, "lon" => lon})
      assert has_element?(view, ".goto-panel [data-answer=allow]")

      assert give(view, "goto", %{"lat" => "#{lat + 0.0003}", "lon" => "#{lon}", "altitude" => "12"}) =~
               ~r/On its way|Arrived/

      SimVehicle.await(sim, &(&1.lat > lat + 0.0002))
      eventually(fn -> has_element?(view, "#commands-now .good", "Arrived") end)
      assert give(view, "land") =~ ~r/Landing|Landed/
      SimVehicle.await(sim, &(not &1.armed))
      eventually(fn -> has_element?(view, "#commands-now .good", "Landed") end)
      eventually(fn -> has_element?(view, ".vehicle-air", "On the ground") end)
      assert view |> element("a.tab", "Events") |> render_click() =~ "took off"
    end
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: a battery that was nearly empty and is changed leaves no alarm behind", %{tmp_dir: dir} do
      {console, sim} = start(dir, unquote(firmware))
      {:ok, view, _html} = live(conn(console, :operator), "/alarms")
      SimVehicle.failsafe(sim, :battery_critical)
      eventually(fn -> has_element?(view, "#alarms .alarm-row.active", "Battery nearly empty") end)
      # Changed without a restart: nothing but the charge says so.
      SimVehicle.happen(sim, :swap_battery)
      eventually(fn -> not has_element?(view, "#alarms .alarm-row.active", "Battery") end)
      eventually(fn -> has_element?(view, "#alarms .alarm-row.over", "Battery nearly empty") end)
    end
  end

  @tag :chromium
  test "in a browser: arm, take off, go where the map is clicked, land by the key; a refusal has its reason",
       %{tmp_dir: dir} do
    {console, sim} = start(dir, :ardupilot)
    browse(console, "vehicle_flight.mjs")
    SimVehicle.await(sim, &(not &1.armed))
  end

  @tag :chromium
  test "in a browser: flown by the keyboard alone; every button keeps its place, and the focus its button", %{
    tmp_dir: dir
  } do
    {console, sim} = start(dir, :ardupilot)
    browse(console, "vehicle_hand.mjs")
    SimVehicle.await(sim, &(not &1.armed))
  end

  @tag :chromium
  test "in a browser: a reload while a command is pending sends nothing again; each part on a phone", %{
    tmp_dir: dir
  } do
    [console: console] = start_console()
    CommandCase.start_commands(dir, gateway: console.gateway)

    put_vehicle(console, "VID-007", [], %{
      key: {"main", 7},
      system_id: 7,
      component: 1,
      clock: %{rtt_us: 20_000},
      memory: %{sources: %{}, mode_names: %{}}
    })

    browse(console, "vehicle_pending.mjs")
    assert_received {:"$gen_call", from, {:submit, %{type: "rtl"} = command, _progress, _still?}}
    CommandCase.answer(from, command.id, :completed)
    CommandCase.refute_submitted()
  end
end
