defmodule Aerie.Vehicle.Services.Reports.SequenceTest do
  @moduledoc "X3: missing events are noticed, requested and given up, whatever is lost, late or duplicated."
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Vehicle.Services.Reports.Sequence

  @ms 1000

  defp seen(numbers, sequence \\ Sequence.new()) do
    Enum.reduce(numbers, {[], sequence}, fn number, {verdicts, sequence} ->
      {verdict, sequence} = Sequence.event(sequence, number, 5000, 0)
      {verdicts ++ [verdict], sequence}
    end)
  end

  test "nothing is requested while events come in order, even when the numbers wrap (X3)" do
    {verdicts, sequence} = seen([65_534, 65_535, 0, 1])
    assert Enum.all?(verdicts, &(&1 == :new))
    assert {^sequence, []} = Sequence.expire(sequence, 10_000 * @ms)
  end

  test "a gap is requested as one range three times, then given up; a late event counts once (X3)" do
    {_, sequence} = seen([65_533, 2])
    refute match?({_, [_ | _]}, Sequence.expire(sequence, 299 * @ms))
    {sequence, asked} = Sequence.expire(sequence, 300 * @ms)
    assert asked == [{65_534, 1}]
    {:new, sequence} = Sequence.event(sequence, 0, 5000, 400 * @ms)
    {:old, sequence} = Sequence.event(sequence, 0, 5000, 400 * @ms)
    {sequence, asked} = Sequence.expire(sequence, 1300 * @ms)
    assert asked == [{65_534, 65_535}, {1, 1}]
    {sequence, [_, _]} = Sequence.expire(sequence, 2300 * @ms)
    assert Sequence.waiting?(sequence)
    {sequence, []} = Sequence.expire(sequence, 3300 * @ms)
    refute Sequence.waiting?(sequence)
    assert sequence.lost == 3
    assert {:old, _} = Sequence.event(sequence, 1, 5000, 3400 * @ms)
  end

  test "CURRENT_EVENT_SEQUENCE shows missing events; the first one only sets the start (X3)" do
    sequence = Sequence.current(Sequence.new(), 100, false, 0)
    refute Sequence.waiting?(sequence)
    sequence = Sequence.current(sequence, 102, false, 0)
    assert {_, [{101, 102}]} = Sequence.expire(sequence, 300 * @ms)
    # Older than the latest one, by a slower link.
    assert Sequence.current(sequence, 100, false, 0) == sequence
  end

  test "RESPONSE_EVENT_ERROR: events that are not kept any more are not requested again (X3)" do
    {_, sequence} = seen([10, 20])
    sequence = Sequence.gone(sequence, 17)
    assert sequence.lost == 6
    assert {_, [{17, 19}]} = Sequence.expire(sequence, 300 * @ms)
    # The answer to a request for a future number also has the oldest one that is kept.
    assert Sequence.gone(sequence, 5) == sequence
  end

  test "one whose clock has wrapped goes on" do
    {:new, sequence} = Sequence.event(Sequence.new(), 7, 0xFFFFFFF0, 0)
    {:new, sequence} = Sequence.event(sequence, 9, 500, 1_000_000)
    assert Map.keys(sequence.missing) == [8]
  end

  test "a component that was restarted begins again (R6)" do
    {_, sequence} = seen([500, 501])
    assert {:new, again} = Sequence.event(%{sequence | boot_ms: 60_000}, 3, 2000, 0)
    refute Sequence.waiting?(again)
    assert {:old, _} = Sequence.event(%{sequence | boot_ms: 60_000}, 500, 59_000, 0)
    reset = Sequence.current(sequence, 3, true, 0)
    assert {:new, reset} = Sequence.event(reset, 4, 2000, 0)
    refute Sequence.waiting?(reset)
  end

  test "after a long absence the last ones are requested, the others are lost" do
    {_, sequence} = seen([0, 1000])
    assert {%{lost: 935}, [{936, 999}]} = Sequence.expire(sequence, 300 * @ms)
  end

  test "whatever comes in whatever order, each number is new once, and the tables are bounded" do
    step =
      :proper_types.frequency([
        {6, {:event, :proper_types.integer(-5, 8)}},
        {1, {:event, :proper_types.integer(0, 65_535)}},
        {2, {:current, :proper_types.integer(-3, 20)}},
        {1, {:gone, :proper_types.integer(-20, 5)}},
        {2, {:wait, :proper_types.integer(1, 2000)}}
      ])

    property =
      :proper.forall({:proper_types.integer(0, 65_535), :proper_types.list(step)}, fn {start, steps} ->
        {:new, first} = Sequence.event(Sequence.new(), start, 5000, 0)

        {_sequence, _now, _new, fine} =
          Enum.reduce(steps, {first, 0, [start], true}, fn step, {sequence, now, new, fine} ->
            number = fn by -> sequence.latest + by &&& 0xFFFF end

            {sequence, now, new, fine} =
              case step do
                {:event, by} ->
                  number = number.(by)
                  was_missing = is_map_key(sequence.missing, number)
                  {verdict, after_it} = Sequence.event(sequence, number, 5000, now)
                  ahead = (number - sequence.latest &&& 0xFFFF) in 1..0x7FFF
                  {after_it, now, new, fine and verdict == :new == (was_missing or ahead)}

                {:current, by} ->
                  {Sequence.current(sequence, number.(by), false, now), now, new, fine}

                {:gone, by} ->
                  {Sequence.gone(sequence, number.(by)), now, new, fine}

                {:wait, ms} ->
                  now = now + ms * @ms
                  {after_it, ranges} = Sequence.expire(sequence, now)

                  asked =
                    for {first, last} <- ranges, i <- 0..(last - first &&& 0xFFFF), do: first + i &&& 0xFFFF

                  {after_it, now, new, fine and Enum.all?(asked, &is_map_key(after_it.missing, &1))}
              end

            {sequence, now, new, fine and map_size(sequence.missing) <= 64 and sequence.lost >= 0}
          end)

        fine
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
