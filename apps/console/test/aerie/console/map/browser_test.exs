defmodule Aerie.Console.Map.BrowserTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.MapPage
  import Aerie.ShadowCase, only: [start_shadow: 2]

  @moduletag :chromium

  setup do: {:ok, start_console()}

  defp three(console) do
    put_vehicle(console, "VID-1", [], %{key: {"main", 1}, system_id: 1})

    put_vehicle(console, "VID-2", [position: %{lat: 47.3985, heading: 200.0}], %{
      key: {"main", 2},
      system_id: 2,
      vehicle_type: "plane",
      status: :lost
    })

    put_vehicle(
      console,
      "VID-3",
      [position: %{lat: 47.397, lon: 8.5475}, mode: %{armed: false, in_air: false}],
      %{
        key: {"main", 3},
        system_id: 3,
        vehicle_type: "rover"
      }
    )
  end

  test "vehicles are drawn and move, are selected, followed and measured; a phone; a broken connection", %{
    console: console
  } do
    three(console)
    fly(console, 1, 47.3977)
    assert browse_map(console, "flows") =~ "ok"
  end

  @tag :tmp_dir
  test "tags colour symbols, far vehicles are a cluster without those that matter, and the lost fade", %{
    console: console,
    tmp_dir: dir
  } do
    start_shadow(console.gateway, dir)
    three(console)
    # Beside the cluster of the other two, at the zoom where they are one.
    put_vehicle(console, "VID-2", [position: %{lat: 47.43, heading: 200.0}], %{
      key: {"main", 2},
      system_id: 2,
      vehicle_type: "plane",
      status: :lost
    })

    :ok = Aerie.Fleet.Shadow.tag(console.gateway, "VID-1", ["survey"])
    assert browse_map(console, "symbols") =~ "ok"
  end

  test "without WebGL the page says so, and its table works", %{console: console} do
    three(console)
    assert browse_map(console, "nowebgl") =~ "ok"
  end
end
