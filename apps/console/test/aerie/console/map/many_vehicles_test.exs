defmodule Aerie.Console.Map.ManyVehiclesTest do
  @moduledoc """
  Many vehicles on the map. The test runs alone: where other browsers draw with software WebGL, too, the page's thread may not run for
  ten seconds, and LiveView's client loads the page again.
  """
  use Aerie.ConsoleCase, async: false

  import Aerie.MapPage

  @moduletag :chromium

  setup do: {:ok, start_console()}

  @tag Aerie.Browser.long()
  test "200 vehicles that change five times a second", %{console: console} do
    for n <- 1..200, do: fly(console, n, 47.39 + rem(n, 20) * 0.0008, 8.53 + div(n, 20) * 0.002)
    output = browse_map(console, "fleet", ["200"])
    IO.puts(output)
    assert output =~ "ok"
  end
end
