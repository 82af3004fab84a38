defmodule Aerie.Fleet.Missions.SeparationTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Missions.{Course, Separation}

  defp course(id, points, until \\ :stays, heights? \\ true),
    do: %Course{id: id, until: until, heights?: heights?, points: for(point <- points, do: floats(point))}

  defp floats(point), do: point |> Tuple.to_list() |> Enum.map(&(&1 / 1)) |> List.to_tuple()

  test "two that cross are nearest where they cross, between all points" do
    one = course("A", [{0, 0, 0, 10}, {20, 100, 0, 10}])
    two = course("B", [{0, 50, -60, 14}, {20, 50, 60, 14}])
    assert {:ok, [pair]} = Separation.pairs([{one, 0, true}, {two, 0, true}])
    assert %{one: "A", other: "B", at_s: 10.0, place: {50.0, +0.0}, heights?: true} = pair
    assert_in_delta pair.metres, 4.0, 1.0e-9
  end

  test "one after the other they do not meet, and the one that waits in the air is there" do
    one = course("A", [{0, 0, 0, 10}, {20, 100, 0, 10}])
    two = course("B", [{0, 50, 0, 10}, {10, 50, 100, 10}])
    assert {:ok, [%{metres: +0.0, at_s: 10.0}]} = Separation.pairs([{one, 0, true}, {two, 30, true}])
    assert {:ok, [%{metres: metres, at_s: 30.0}]} = Separation.pairs([{one, 0, true}, {two, 30, false}])
    assert metres == 50.0
  end

  test "one that has landed is in nobody's way, one that stays is" do
    gone = course("A", [{0, 0, 0, 0}, {10, 50, 0, 0}], :ends)
    late = course("B", [{0, 50, 500, 0}, {100, 50, 0, 0}])
    assert {:ok, [%{metres: metres, at_s: 10.0}]} = Separation.pairs([{gone, 0, true}, {late, 0, true}])
    assert metres > 400

    assert {:ok, [%{metres: +0.0, at_s: 100.0}]} =
             Separation.pairs([{%{gone | until: :stays}, 0, true}, {late, 0, true}])
  end

  test "without a common height only the map counts, and who is never there at the same time has no pass" do
    low = course("A", [{0, 0, 0, 10}], :stays, false)
    high = course("B", [{0, 3, 4, 500}])
    assert {:ok, [%{metres: 5.0, heights?: false}]} = Separation.pairs([{low, 0, true}, {high, 0, true}])
    assert {:ok, []} = Separation.pairs([{course("A", []), 0, true}, {high, 0, true}])

    short = course("A", [{0, 0, 0, 10}, {5, 1, 0, 10}], :ends)
    assert {:ok, []} = Separation.pairs([{short, 0, false}, {high, 60, false}])
    assert {:ok, []} = Separation.pairs([{high, 0, true}])
  end

  test "too many are refused, and 60 vehicles of 200 items are not" do
    points = for n <- 0..200, do: {n, n * 5, rem(n, 2) * 40, 10}

    fleet =
      for n <- 1..60,
          do: {course("V#{n}", for({t, x, y, z} <- points, do: {t, x, y + n * 50, z})), n * 10, true}

    assert {:ok, pairs} = Separation.pairs(fleet)
    assert length(pairs) == div(60 * 59, 2)
    assert {:error, "the plans are too many" <> _} = Separation.pairs(fleet ++ fleet)
  end

  test "nothing that is looked at step by step is nearer than what was found" do
    number = :proper_types.float(-100.0, 100.0)

    point =
      :proper_types.tuple([:proper_types.float(0.0, 8.0), number, number, :proper_types.float(0.0, 20.0)])

    way = :proper_types.vector(6, point)
    start = :proper_types.float(0.0, 30.0)
    flag = :proper_types.boolean()

    property =
      :proper.forall({way, way, start, flag, flag}, fn {one, two, start, waits?, stays?} ->
        one = course("A", timed(one), if(stays?, do: :stays, else: :ends))
        two = course("B", timed(two))
        {:ok, pairs} = Separation.pairs([{one, 0, true}, {two, start, waits?}])

        seen =
          for n <- 0..1_000,
              t = n / 10,
              a = at(one, t, true),
              b = at(two, t - start, waits?),
              a != nil and b != nil,
              do: {distance(a, b), t}

        case {pairs, Enum.min(seen, fn -> nil end)} do
          {[], nil} ->
            true

          # In the air together for less than a step.
          {[_pair], nil} ->
            true

          {[pair], {metres, _t}} ->
            there = distance(at(one, pair.at_s, true), at(two, max(pair.at_s - start, 0.0), true))
            pair.metres <= metres + 1.0e-6 and abs(there - pair.metres) < 1.0e-6 * max(1.0, there) + 1.0e-4
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  # What is given as durations, as times.
  defp timed(points) do
    {points, _t} = Enum.map_reduce(points, 0.0, fn {t, x, y, z}, at -> {{at, x, y, z}, at + t} end)
    points
  end

  defp at(%{points: [{_t, x, y, z} | _]}, t, waits?) when t < 0, do: if(waits?, do: {x, y, z})

  defp at(%{points: points, until: until}, t, _waits?) do
    {last, x, y, z} = List.last(points)

    case Enum.find(Enum.zip(points, tl(points)), fn {{t1, _, _, _}, {t2, _, _, _}} ->
           t1 <= t and t <= t2 and t2 > t1
         end) do
      {{t1, x1, y1, z1}, {t2, x2, y2, z2}} ->
        s = (t - t1) / (t2 - t1)
        {x1 + s * (x2 - x1), y1 + s * (y2 - y1), z1 + s * (z2 - z1)}

      nil ->
        if until == :stays and t >= last, do: {x, y, z}
    end
  end

  defp distance({a, b, c}, {x, y, z}), do: :math.sqrt((a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2)
end
