defmodule Aerie.Fleet.Replay.ClockTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Replay.Clock

  @second 1_000_000

  defp at(time) do
    {[], clock} = Clock.advance(Clock.new(), time)
    clock
  end

  test "ticks lie 100 ms apart, before the frame that they are due before" do
    assert {[], clock} = Clock.advance(at(0), 99_999)
    assert {[100_000], clock} = Clock.advance(clock, 100_000)
    assert {[200_000, 300_000], clock} = Clock.advance(clock, 350_000)
    assert {[], _clock} = Clock.advance(clock, 399_999)
  end

  test "a silence is gone through ever more coarsely, and a gap of a year costs no more than ten minutes" do
    assert {ticks, _clock} = Clock.advance(at(0), 20 * @second)
    assert length(ticks) == 100 + 10
    assert {ten_minutes, _clock} = Clock.advance(at(0), 600 * @second)
    now = 1_795_000_000 * @second
    assert {year, clock} = Clock.advance(at(now), now + 365 * 86_400 * @second)
    assert length(year) == length(ten_minutes)
    assert length(year) < 700
    assert clock.passed == 0
    assert {[], _clock} = Clock.advance(clock, now + 365 * 86_400 * @second + 1)
  end

  test "a recorder that gets the time starts again, and has not recorded for decades" do
    {[_ | _], clock} = Clock.advance(at(0), 5 * @second)
    assert {:restarted, clock} = Clock.advance(clock, 1_795_000_000 * @second)
    assert {[_ | _], clock} = Clock.advance(clock, 1_795_000_002 * @second)
    assert clock.passed == 7 * @second
  end

  test "frames that overtake each other stop time, an older recording begins it again" do
    clock = at(10 * @second)
    assert {[], %{now: 10_000_000}} = Clock.advance(clock, 8 * @second)
    assert {:restarted, clock} = Clock.advance(clock, 8 * @second - 1)
    assert {[8_099_999], _clock} = Clock.advance(clock, 8 * @second + 100_000)
  end
end
