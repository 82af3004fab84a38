defmodule Aerie.Fleet.Bridge.Commands.QueueTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Commands.Queue
  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Control.Policy.Roles.Sources

  @second 1_000_000

  # So many requests of a kind; gives what became of each, and the lanes.
  defp arrive(lanes, claim, number, now \\ 0) do
    Enum.map_reduce(1..number, lanes, fn n, lanes ->
      case Queue.arrive(lanes, claim, n, false, now) do
        {:run, phase, lanes} -> {phase, lanes}
        {:wait, lanes} -> {:wait, lanes}
        :drop -> {:drop, lanes}
      end
    end)
  end

  test "what nobody signed who may has few places and a rate, and takes none of the others'" do
    {flood, lanes} = arrive(Queue.new(0), :refused, 10_000)
    assert Enum.frequencies(flood) == %{refused: 8, drop: 9_992}
    assert {:run, {:checking, "K"}, lanes} = Queue.arrive(lanes, {:listed, "K"}, :command, false, 0)

    # However quickly they are refused, a hundred are answered, and then twenty a second: here for two seconds.
    {answered, _lanes} =
      Enum.map_reduce(1..10_000, Queue.new(0), fn n, lanes ->
        case Queue.arrive(lanes, :refused, n, false, n * 200) do
          {:run, :refused, lanes} -> {1, lanes |> Queue.left(:refused) |> elem(1)}
          :drop -> {0, lanes}
        end
      end)

    assert Enum.sum(answered) in 139..141
    assert Queue.count(lanes, :refused) == 8
  end

  test "forged requests of one key wait for one another, in order, and none of another key waits for them" do
    {first, lanes} = arrive(Queue.new(0), {:listed, "forged"}, 1_000)
    assert Enum.frequencies(first) == %{{:checking, "forged"} => 8, wait: 256, drop: 736}
    refute Queue.room?(lanes, "forged")
    assert {:run, {:checking, "K"}, lanes} = Queue.arrive(lanes, {:listed, "K"}, :command, false, 0)
    assert {:signed, :none, lanes} = Queue.verified(lanes, "K", "s1", false, 0)

    # Each that is refused lets the next one of its key in.
    {{:ok, 9}, lanes} = Queue.left(lanes, {:checking, "forged"})
    {{:ok, 10}, lanes} = Queue.left(lanes, {:checking, "forged"})
    assert Queue.count(lanes, {:checking, "forged"}) == 8
    {:none, lanes} = Queue.left(lanes, :signed)
    assert Queue.count(lanes, :signed) == 0
  end

  test "copies of a signed message have few places of their own" do
    check = fn lanes, signature, now ->
      {:run, phase, lanes} = Queue.arrive(lanes, {:listed, "K"}, :command, false, now)
      {phase, :none, lanes} = verified(lanes, phase, signature, now)
      {phase, lanes}
    end

    {first, lanes} = Enum.map_reduce(1..100, Queue.new(0), fn _n, lanes -> check.(lanes, "the same", 0) end)
    assert Enum.frequencies(first) == %{:signed => 1, :copy => 32, nil => 67}
    assert {:signed, lanes} = check.(lanes, "another", 0)
    # Known for as long as a signature counts.
    assert {nil, lanes} = check.(lanes, "the same", 59 * @second)
    {:none, lanes} = Queue.left(lanes, :copy)
    assert {:copy, lanes} = check.(lanes, "the same", 61 * @second)
    lanes = Enum.reduce([130, 200], lanes, fn s, lanes -> lanes |> check.("#{s}", s * @second) |> elem(1) end)
    assert {:signed, _lanes} = check.(lanes, "the same", 270 * @second)
  end

  defp verified(lanes, {:checking, key}, signature, now),
    do: Queue.verified(lanes, key, signature, false, now)

  test "what a role lets unsigned requests do leaves half of the places to signed ones, and what ends a flight has its own" do
    {first, lanes} = arrive(Queue.new(0), :unsigned, 300)
    assert Enum.frequencies(first) == %{unsigned: 256, busy: 16, drop: 28}
    assert {:run, :unsigned, _lanes} = Queue.arrive(lanes, :unsigned, :land, true, 0)

    lanes =
      Enum.reduce(1..512, lanes, fn n, lanes ->
        {:run, {:checking, "K"}, lanes} = Queue.arrive(lanes, {:listed, "K"}, n, false, 0)
        {:signed, :none, lanes} = Queue.verified(lanes, "K", "#{n}", false, 0)
        lanes
      end)

    {:run, _checking, lanes} = Queue.arrive(lanes, {:listed, "K"}, :next, false, 0)
    assert {nil, :none, lanes} = Queue.verified(lanes, "K", "next", false, 0)
    {:run, _checking, lanes} = Queue.arrive(lanes, {:listed, "K"}, :land, true, 0)
    assert {:signed, :none, _lanes} = Queue.verified(lanes, "K", "land", true, 0)
  end

  test "a claim is read from the header alone, and only a fresh one of a listed key counts" do
    key = Nkey.generate(:user)
    now = System.os_time(:microsecond)
    listed = %{nkey: key.public, name: "ops", role: :operator, permissions: [], expires: nil}
    policy = %{unsigned: nil, sources: [listed]}
    sign = fn key, time -> Signature.sign(key, "subject", "body", DateTime.from_unix!(time, :microsecond)) end

    assert Sources.claim(policy, sign.(key, now), now) == {:listed, key.public}
    [public, at, _signature] = String.split(sign.(key, now))
    forged = Enum.join([public, at, Base.url_encode64(:crypto.strong_rand_bytes(64), padding: false)], " ")
    assert Sources.claim(policy, forged, now) == {:listed, key.public}

    for {policy, header} <- [
          {nil, sign.(key, now)},
          {policy, nil},
          {policy, ""},
          {policy, String.duplicate("x", 600)},
          {policy, sign.(Nkey.generate(:user), now)},
          {%{policy | sources: [%{listed | expires: now}]}, sign.(key, now)},
          {%{policy | unsigned: :operator}, "garbage"}
        ],
        do: assert({header, Sources.claim(policy, header, now)} == {header, :refused})

    assert Sources.claim(%{policy | unsigned: :operator}, nil, now) == :unsigned
    assert Sources.fresh?(sign.(key, now), now) and Sources.fresh?(forged, now)

    for header <- [
          sign.(key, now - 61 * @second),
          sign.(key, now + 6 * @second),
          "#{public} #{at} c2hvcnQ",
          public
        ],
        do: refute(Sources.fresh?(header, now))
  end
end
