defmodule Aerie.Access.WorkLimitTest do
  @moduledoc "What costs much is done a few at a time, and refused beyond that."
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Access.WorkLimit
  alias Aerie.Access.WorkLimit.Places

  defp pool do
    gateway = make_ref()
    clock = :counters.new(1, [])
    start_supervised!({WorkLimit, gateway: gateway, now: fn -> :counters.get(clock, 1) end})
    %{gateway: gateway, clock: clock}
  end

  # Work that says who it is and waits to be told to end.
  defp held(test, n) do
    fn ->
      send(test, {:working, n, self(), Process.info(self(), :priority)})
      receive do: (:go -> n)
    end
  end

  defp ask(gateway, kind, asker, n) do
    test = self()
    Task.async(fn -> WorkLimit.run(gateway, kind, asker, held(test, n)) end)
  end

  test "of a kind so many are done at once, by low processes, and the others in their turn" do
    %{gateway: gateway} = pool()
    half = max(div(System.schedulers_online(), 2), 1)
    tasks = for n <- 1..(half + 2), do: ask(gateway, :password, {:place, n, false}, n)
    first = for _n <- 1..half, do: assert_receive({:working, _n, _pid, {:priority, :low}})
    # The pool has heard of all of them: who asks again is refused at once.
    pool = Aerie.Base.Names.whereis(gateway, :costly)
    eventually(fn -> MapSet.size(:sys.get_state(pool).places.askers) == half + 2 end)
    assert {:busy, 2} = WorkLimit.run(gateway, :password, {:place, half + 2, false}, fn -> :never end)
    refute_received {:working, _n, _pid, _priority}

    for {:working, _n, pid, _priority} <- first, do: send(pid, :go)

    for _n <- 1..2,
        do: with({:working, _n, pid, _low} <- assert_receive({:working, _, _, _}), do: send(pid, :go))

    assert tasks |> Task.await_many(Aerie.Patience.ms()) |> Enum.sort() ==
             for(n <- 1..(half + 2), do: {:ok, n})
  end

  test "a flood of hashes never has more than its places, nobody's second one waits, and who is known goes first" do
    places = Places.new(%{password: 2})

    {answers, places} =
      Enum.map_reduce(1..1_000, places, fn n, places ->
        case Places.ask(places, :password, rem(n, 100), false, n) do
          :busy -> {:busy, places}
          {answer, places} -> {answer, places}
        end
      end)

    assert Enum.frequencies(answers) == %{run: 2, wait: 16, busy: 982}
    assert {:wait, places} = Places.ask(places, :password, :known, true, :known)
    assert {{:ok, :known}, places} = Places.done(places, :password, 1)
    assert {{:ok, 3}, places} = Places.done(places, :password, 2)
    assert Places.running(places, :password) == 2
    # Whoever is done may ask again.
    assert {:wait, _places} = Places.ask(places, :password, 1, false, :again)
  end

  test "a user has so many of a kind, and then one in a while; what fails is nobody else's fault" do
    %{gateway: gateway, clock: clock} = pool()
    me = {:name, "vic"}
    for n <- 1..5, do: assert(WorkLimit.run(gateway, :password, me, fn -> n end) == {:ok, n})
    assert {:busy, 12} = WorkLimit.run(gateway, :password, me, fn -> 6 end)
    assert {:ok, 1} = WorkLimit.run(gateway, :password, {:name, "ann"}, fn -> 1 end)
    assert {:ok, 1} = WorkLimit.run(gateway, :parse, me, fn -> 1 end)
    :counters.add(clock, 1, 12_000)
    assert {:ok, 7} = WorkLimit.run(gateway, :password, me, fn -> 7 end)

    assert {:shutdown, :broken} =
             catch_exit(WorkLimit.run(gateway, :parse, me, fn -> exit({:shutdown, :broken}) end))

    assert {:ok, 8} = WorkLimit.run(gateway, :parse, me, fn -> 8 end)

    assert Enum.count(1..1_000, fn _n -> WorkLimit.spend(gateway, "vic", 1) end) == 400
    refute WorkLimit.spend(gateway, "vic", 1)
    assert WorkLimit.spend(gateway, "ann", 5)
    assert {:busy, 1} = WorkLimit.run(make_ref(), :parse, me, fn -> :never end)
  end
end
