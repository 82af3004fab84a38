defmodule Aerie.Vehicle.Session.ClockTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Session.Clock

  @second 1_000_000
  # The machine's clock less the monotonic one.
  @host 1_000 * @second

  defp restarted?(clock, speed, now, at, moment) do
    seconds = &(&1 && round(&1 * @second))
    Clock.restarted?(clock, speed, seconds.(now), seconds.(at), seconds.(moment), @host)
  end

  defp heard(at, moment, speed), do: Clock.frame(at * @second, moment * @second, speed)

  test "time goes on from the last frame, at the speed of its link, and not back" do
    assert Clock.expected(nil, 5 * @second) == nil
    assert Clock.expected(heard(1_005, 5, :live), 7 * @second) == 1_007 * @second
    assert Clock.expected(heard(100, 5, 10.0), 7 * @second) == 120 * @second
    assert Clock.expected(heard(1_005, 5, :live), 4 * @second) == 1_005 * @second
  end

  test "live frames do not restart time, late or after a silence, unless the machine's clock has not reached them" do
    clock = heard(1_005, 5, :live)
    refute restarted?(clock, :live, 1_005, 1_060, 60)
    refute restarted?(clock, :live, 1_060, 1_005, 60)
    assert restarted?(clock, :live, 1_005, 4_660, 60)
    # The next one, after one from the future.
    assert restarted?(heard(4_660, 60, :live), :live, 4_660, 1_061, 61)
  end

  test "the first live frames after a restart or a recording do, if they are not about when they are expected" do
    for clock <- [Clock.new(1_005 * @second, 5 * @second, 1.0), heard(1_005, 5, 1.0)] do
      refute restarted?(clock, :live, 1_005, 1_008, 6)
      assert restarted?(clock, :live, 1_005, 1_060, 6)
    end

    refute restarted?(nil, :live, nil, 1_060, 6)
  end

  test "a recording does that goes back" do
    for clock <- [nil, heard(100, 5, 1.0), heard(1_005, 5, :live)] do
      refute restarted?(clock, 1.0, 100, 98, 6)
      assert restarted?(clock, 1.0, 100, 97, 6)
      refute restarted?(clock, 1.0, 100, 9_000, 6)
    end
  end
end
