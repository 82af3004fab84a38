defmodule Aerie.Console.Map.ManyVehiclesTest do
  @moduledoc """
  Many vehicles on the map. The test runs alone, because other browsers that draw with software WebGL would take the processor from it.
  """
  use Aerie.ConsoleCase, async: false

  import Aerie.MapPage

  @moduletag :chromium

  # As often as a gateway tells pages of changes: for each the browser compares the whole table.
  setup do: {:ok, start_console(pubsub_tick_ms: 200)}

  @tag Aerie.Browser.long()
  test "200 vehicles that change five times a second", %{console: console} do
    for n <- 1..200, do: fly(console, n, 47.39 + rem(n, 20) * 0.0008, 8.53 + div(n, 20) * 0.002)
    output = browse_map(console, "fleet", ["200"])
    IO.puts(output)
    assert output =~ "ok"
  end
end
