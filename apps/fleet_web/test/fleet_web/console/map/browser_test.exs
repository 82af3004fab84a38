defmodule FleetWeb.Console.Map.BrowserTest do
  use FleetWeb.ConsoleCase, async: true

  @moduletag :chromium

  setup do: {:ok, start_console()}

  # Screenshots, for a look: AERIE_SHOTS=FOLDER.
  defp browse_map(console, task, more \\ []) do
    shots = List.wrap(System.get_env("AERIE_SHOTS"))

    browse(
      console,
      "map.mjs",
      ["operator", password(:operator), task] ++ if(more == [], do: ["-"], else: more) ++ shots
    )
  end

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

  test "without WebGL the page says so, and its table works", %{console: console} do
    three(console)
    assert browse_map(console, "nowebgl") =~ "ok"
  end

  @tag Aerie.Browser.long()
  test "200 vehicles that change five times a second", %{console: console} do
    for n <- 1..200, do: fly(console, n, 47.39 + rem(n, 20) * 0.0008, 8.53 + div(n, 20) * 0.002)
    output = browse_map(console, "fleet", ["200"])
    IO.puts(output)
    assert output =~ "ok"
  end

  # A vehicle that flies a circle, 5 times a second, until the test ends.
  defp fly(console, n, lat, lon \\ 8.5456) do
    start_supervised!(
      {Task,
       fn ->
         for step <- Stream.iterate(n, &(&1 + 1)) do
           angle = step / 10
           position = %{lat: lat + 0.0004 * :math.sin(angle), lon: lon + 0.0006 * :math.cos(angle)}

           position =
             Map.merge(position, %{heading: rem(round(-angle * 57.3), 360) + 360.0, alt_rel: 20.0 + n})

           velocity = %{
             vn: 4.0 * :math.cos(angle),
             ve: -4.0 * :math.sin(angle),
             groundspeed: 4.0 + rem(step, 10) / 10
           }

           put_vehicle(console, "VID-#{n}", [position: position, velocity: velocity], %{
             key: {"main", n},
             system_id: n
           })

           Process.sleep(200)
         end
       end},
      id: {:fly, n}
    )
  end
end
