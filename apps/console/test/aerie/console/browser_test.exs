defmodule Aerie.Console.BrowserTest do
  @moduledoc "What only a browser can show."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Commands
  alias Aerie.Console.HTTP.Router

  @moduletag :chromium
  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    [console: console] = start_console()
    Aerie.CommandCase.start_commands(dir, gateway: console.gateway, policy: [max_altitude: 100])
    put_vehicle(console, "VID-007", [], %{key: {"main", 7}, system_id: 7, component: 1})

    put_vehicle(console, "VID-002", [mode: %{armed: false, mode: "STABILIZE", in_air: false}], %{
      status: :stale
    })

    put_link(console, "radio")
    %{console: console}
  end

  defp types(console), do: for(%{type: type} <- Commands.recent(console.gateway, "VID-007", 20), do: type)

  test "signing in and out, roles, keys, the look, the button that has to be held", %{console: console} do
    output = browse(console, "access.mjs")

    [holds, rtls] =
      for [_all, count] <- Regex.scan(~r/^(?:hold|rtl): (\d+)$/m, output), do: String.to_integer(count)

    assert holds >= 2 and rtls == 1
    assert Enum.frequencies(types(console)) == %{"hold" => holds, "rtl" => rtls}
  end

  test "the palette, the search and the skip links by the keyboard alone", %{console: console} do
    put_vehicle(console, "V<i>8", [], %{key: {"main", 8}, system_id: 8, component: 1})
    browse(console, "palette.mjs")
    assert types(console) == []
  end

  @tag Aerie.Browser.long()
  test "every page, narrow and wide, dark and light, is sound, accessible and small", %{console: console} do
    browse(console, "pages.mjs", paths())
  end

  # The parameters of a path are vehicles.
  defp paths,
    do: for(%{path: path} <- Phoenix.Router.routes(Router), do: String.replace(path, ~r/:[a-z]+/, "VID-007"))

  test "a gateway that goes away is shown, nothing is sent meanwhile, and the page recovers by itself", %{
    console: console
  } do
    script = browser(console, "lost.mjs")
    await_line(script, "ready")
    :ok = stop_console(console)
    Port.command(script, "gone\n")
    await_line(script, "tried")
    put_vehicle(console, "VID-007", [mode: %{mode: "BRAKE"}], %{key: {"main", 7}, system_id: 7, component: 1})

    [console: again] = start_console(gateway: console.gateway, dir: console.dir, port: console.port)
    Port.command(script, "back\n")
    await_line(script, "back")
    await_line(script, "ok")
    assert types(again) == []
  end
end
