defmodule Aerie.Base.Timing.BackoffTest do
  use ExUnit.Case, async: true

  import :proper_types

  alias Aerie.Base.Timing.Backoff

  test "the first retry is at once, the second after 250 to 500 ms" do
    assert {0, backoff} = Backoff.next(Backoff.new(), 0.7)
    assert {250, _} = Backoff.next(backoff, 0.0)
    assert {500, backoff} = Backoff.next(backoff, 1.0)
    assert {500, _} = Backoff.next(backoff, 0.0)
    assert {1000, _} = Backoff.next(backoff, 1.0)
  end

  test "after something short that was good it is soon, never at once" do
    {_wait, first} = Backoff.next(Backoff.new(), 0.5)
    long = Enum.reduce(1..8, first, fn _n, backoff -> elem(Backoff.next(backoff, 0.5), 1) end)
    assert {wait, _} = Backoff.next(Backoff.soon(long), 0.5)
    assert wait in 250..500
    assert {0, _} = Backoff.next(Backoff.soon(Backoff.new()), 0.5)
  end

  test "a reset begins again" do
    {_, backoff} = Backoff.next(Backoff.new(), 0.5)
    {_, backoff} = Backoff.next(backoff, 0.5)
    assert {0, _} = Backoff.next(Backoff.reset(backoff), 0.5)
  end

  test "every wait but the first lies within the bounds, grows, and stays at its maximum" do
    property =
      :proper.forall(non_empty(list(float(0.0, 1.0))), fn randoms ->
        {waits, _backoff} = Enum.map_reduce(randoms, Backoff.new(), &Backoff.next(&2, &1))
        [first | rest] = waits
        ceilings = for n <- 1..max(length(rest), 1), do: min(30_000, 250 * Integer.pow(2, min(n, 20)))

        first == 0 and Enum.all?(rest, &(&1 in 250..30_000)) and
          Enum.zip(rest, ceilings) |> Enum.all?(fn {wait, top} -> wait <= top and 2 * wait >= top end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  test "a wait stays within its limits after any number of attempts" do
    for attempts <- [1, 2, 3, 10, 1_000, 1_000_000],
        random <- [0.0, 0.5, 1.0],
        do: assert(Backoff.wait(attempts, 250, 30_000, random) in 250..30_000)

    assert Backoff.wait(0, 250, 30_000, 1.0) == 0
  end

  test "any bounds are kept" do
    property =
      :proper.forall({pos_integer(), non_neg_integer(), range(1, 100), float(0.0, 1.0)}, fn {min, more, n,
                                                                                             random} ->
        backoff =
          Enum.reduce(1..n, Backoff.new(min, min + more), fn _, b -> elem(Backoff.next(b, random), 1) end)

        elem(Backoff.next(backoff, random), 0) in min..(min + more)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
