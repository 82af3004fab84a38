defmodule Gnat.BackoffTest do
  use ExUnit.Case, async: true

  alias Gnat.Backoff

  test "is at once, then doubles between its limits" do
    assert waits(Backoff.new(250, 30_000), 1.0, 10) == [
             0,
             250,
             500,
             1_000,
             2_000,
             4_000,
             8_000,
             16_000,
             30_000,
             30_000
           ]

    assert waits(Backoff.new(250, 30_000), 0.0, 4) == [0, 125, 250, 500]
  end

  test "is at once again after a success" do
    {_, backoff} = Backoff.next(Backoff.new(1, 10), 0.5)
    {1, backoff} = Backoff.next(backoff, 0.5)
    assert {0, _} = Backoff.next(Backoff.reset(backoff), 0.5)
  end

  test "never leaves its limits, however often and whatever the chance" do
    property =
      :proper.forall(
        {:proper_types.integer(1, 5_000), :proper_types.integer(0, 60_000), :proper_types.integer(1, 100),
         :proper_types.float(0.0, 1.0)},
        fn {min, more, count, random} ->
          [0 | waits] = waits(Backoff.new(min, min + more), random, count + 1)
          Enum.all?(waits, &(&1 >= div(min, 2) and &1 <= min + more))
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp waits(backoff, random, count) do
    {waits, _} = Enum.map_reduce(1..count, backoff, fn _, backoff -> Backoff.next(backoff, random) end)
    waits
  end
end
