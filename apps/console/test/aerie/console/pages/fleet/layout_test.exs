defmodule Aerie.Console.Pages.Fleet.LayoutTest do
  @moduledoc "The room that map and table share, in a browser."
  use Aerie.ConsoleCase, async: true

  @tag :chromium
  test "the bar moves and is kept, the table folds away, and a phone shows map and rows" do
    [console: console] = start_console()

    for n <- 1..14 do
      id = "V#{String.pad_leading("#{n}", 2, "0")}"
      mode = Enum.at(~w(AUTO_LOITER AUTO_FOLLOW_TARGET STABILIZE GUIDED), rem(n, 4))
      status = if n == 7, do: :stale, else: :online
      put_vehicle(console, id, [mode: %{mode: mode}], %{key: {"main", n}, system_id: n, status: status})
    end

    browse(console, "layout.mjs")
  end
end
