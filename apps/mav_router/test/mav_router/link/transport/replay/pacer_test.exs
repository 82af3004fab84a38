defmodule MavRouter.Link.Transport.Replay.PacerTest do
  use ExUnit.Case, async: true

  import :proper_types

  alias MavRouter.Link.Transport.Replay.Pacer

  test "in real time each record waits for its turn" do
    assert {:due, pacer} = Pacer.schedule(Pacer.new(1.0), 1_000_000, 50)
    assert {1, pacer} = Pacer.schedule(pacer, 1_000_500, 50)
    assert {500, pacer} = Pacer.schedule(pacer, 1_500_000, 50)
    assert {250, pacer} = Pacer.schedule(pacer, 1_500_000, 250_050)
    assert {:due, _} = Pacer.schedule(pacer, 1_500_000, 500_050)
  end

  test "scaled" do
    {:due, fast} = Pacer.schedule(Pacer.new(10.0), 0, 0)
    assert {100, _} = Pacer.schedule(fast, 1_000_000, 0)
    {:due, slow} = Pacer.schedule(Pacer.new(0.5), 0, 0)
    assert {2000, _} = Pacer.schedule(slow, 1_000_000, 0)
  end

  test "as fast as possible" do
    assert {:due, _} = Pacer.schedule(Pacer.new(:max), 9_999_999_999, 0)
  end

  test "a long gap, or a clock that was set, is not waited for" do
    {:due, pacer} = Pacer.schedule(Pacer.new(1.0), 1_000_000, 0)
    assert {600_000, pacer} = Pacer.schedule(pacer, 601_000_000, 0)
    assert {{:jump, 601_000_000}, pacer} = Pacer.schedule(pacer, 602_000_000, 10)
    assert {1000, pacer} = Pacer.schedule(pacer, 603_000_000, 10)
    assert {{:jump, back}, _pacer} = Pacer.schedule(pacer, 1_000_000, 10)
    assert back < 0
  end

  test "a step back in time does not stall the replay" do
    {:due, pacer} = Pacer.schedule(Pacer.new(1.0), 5_000_000, 0)
    {{:jump, _back}, pacer} = Pacer.schedule(pacer, 1_000, 10)
    assert {1000, _} = Pacer.schedule(pacer, 1_001_000, 10)
  end

  test "waiting as told ends exactly on time, never early" do
    property =
      :proper.forall({list(non_neg_integer()), float(0.01, 100.0)}, fn {gaps, speed} ->
        times = Enum.scan([0 | gaps], &+/2)

        {_pacer, _now, early?} =
          Enum.reduce(times, {Pacer.new(speed), 0, false}, fn at, {pacer, now, early?} ->
            {pacer, now} = wait(pacer, at, now)
            {pacer, now, early? or now < at / speed or now > at / speed + 1000}
          end)

        not early?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp wait(pacer, at, now) do
    case Pacer.schedule(pacer, at, now) do
      {:due, pacer} -> {pacer, now}
      {ms, pacer} -> wait(pacer, at, now + ms * 1000)
    end
  end
end
