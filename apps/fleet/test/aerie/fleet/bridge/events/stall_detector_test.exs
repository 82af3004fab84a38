defmodule Aerie.Fleet.Bridge.Events.StallDetectorTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Events.StallDetector

  defp look(stall, seconds, waiting?),
    do: Enum.reduce(seconds, stall, &StallDetector.check(&2, &1 * 1000, waiting?))

  test "events that wait without a confirmation are a problem after ten seconds, none that wait are not" do
    refute look(StallDetector.new(), 0..1000, false).problem?
    stall = look(StallDetector.new(), 0..9, true)
    refute stall.problem?
    assert StallDetector.ms(stall, 9_000) == 9_000
    assert look(stall, 10..10, true).problem?
  end

  test "a backlog that moves is not a stall" do
    stall =
      Enum.reduce(0..1000, StallDetector.new(), fn second, stall ->
        stall |> StallDetector.check(second * 1000, true) |> StallDetector.confirmed(second * 1000)
      end)

    refute stall.problem?
  end

  test "it is over when all was well for five seconds, not with the first confirmation" do
    stall = StallDetector.new() |> look(0..20, true) |> StallDetector.confirmed(20_500)
    stall = look(stall, 21..25, true)
    assert stall.problem?
    refute look(stall, 26..26, true).problem?
    refute look(stall, 26..26, false).problem?
    # Stuck again before that: it goes on.
    stuck = look(stall, 26..50, true)
    assert stuck.problem?
  end
end
