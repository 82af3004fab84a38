defmodule Aerie.Console.ClockTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Console.Clock

  @us 1_795_790_345_123_456
  @iso "2026-11-27T14:39:05.123Z"

  test "the same moment is written the same, whether it is a number or a text; 24 hours, UTC (F9)" do
    for moment <- [@us, @iso] do
      assert Clock.time(moment) == "14:39:05"
      assert Clock.minute(moment) == "14:39 UTC"
      assert Clock.stamp(moment) == "2026-11-27 14:39:05"
      assert Clock.full(moment) == "2026-11-27 14:39:05 UTC"
      assert Clock.iso(moment) == @iso
    end

    assert Clock.stamp(nil) == "–"
    assert Clock.full(nil) == "–"
  end

  test "the header of every page has the time with its zone" do
    [console: console] = start_console()

    for path <- ["/", "/alarms", "/settings"] do
      {:ok, view, _html} = live(conn(console, :operator), path)
      assert has_element?(view, "#clock", ~r/\A\d\d:\d\d UTC\z/)
    end
  end
end
