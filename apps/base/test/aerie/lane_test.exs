defmodule Aerie.LaneTest do
  use ExUnit.Case, async: true

  alias Aerie.Lane

  setup do
    {:ok, places: for(n <- 1..2, do: "aerie-lane-test #{System.pid()} #{System.unique_integer()} #{n}")}
  end

  test "never more hold a place than there are places, and everybody gets one", %{places: places} do
    inside = :counters.new(1, [:atomics])

    takers =
      for _taker <- 1..40 do
        Task.async(fn ->
          place = Lane.take(places)
          :counters.add(inside, 1, 1)
          # Others have the chance to come in.
          for _turn <- 1..100, do: :erlang.yield()
          seen = :counters.get(inside, 1)
          :counters.sub(inside, 1, 1)
          Lane.leave(place)
          seen
        end)
      end

    seen = Task.await_many(takers, Aerie.Patience.ms())
    assert length(seen) == 40
    assert Enum.max(seen) <= 2
  end

  test "a place is free when its holder dies", %{places: [place, _other]} do
    holder = Lane.take([place])
    next = Task.async(fn -> Lane.take([place]) end)
    Process.exit(holder, :kill)
    assert next |> Task.await(Aerie.Patience.ms()) |> is_pid()
  end

  test "another name is another lane", %{places: [one, other]} do
    assert is_pid(Lane.take([one]))
    assert is_pid(Lane.take([other]))
  end
end
