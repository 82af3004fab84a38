defmodule Aerie.Console.Pages.Plan.BrowserTest do
  @moduledoc "A plan drawn with the mouse, for a simulated vehicle behind UDP."
  use Aerie.ConsoleCase, async: true

  alias Aerie.TransferCase

  @moduletag :chromium
  @moduletag :tmp_dir
  @moduletag :capture_log

  test "a mission is drawn, judged, sent, compared, read back, saved and opened; a fence beside it", %{
    tmp_dir: dir
  } do
    {gateway, port} = TransferCase.start(dir, %{max_altitude: 100})
    [console: console] = start_console(gateway: gateway)
    TransferCase.fly(gateway, port, firmware: :ardupilot)
    eventually(fn -> get_in(Aerie.Base.Store.vehicle(gateway, "VID-001").groups, [:home, :data, :lat]) end)
    browse(console, "plan.mjs")
  end
end
