defmodule Aerie.Base.StoreTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.PubSub
  alias Aerie.Base.Store
  alias Aerie.Base.Store.Links

  defp start_gateway do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway}, id: {Store, gateway})
    start_supervised!({PubSub, gateway: gateway, tick_ms: 5}, id: {PubSub, gateway})
    gateway
  end

  defp vehicle(id, extra \\ %{}), do: Map.merge(%{id: id, status: :online}, extra)

  test "a vehicle is found by its name and by its key, and in the list by the order of keys" do
    gateway = start_gateway()
    Store.put_vehicle(gateway, {"main", 2}, vehicle("B"))
    Store.put_vehicle(gateway, {"main", 1}, vehicle("A"))

    assert Store.vehicle(gateway, "A") == vehicle("A")
    assert Store.vehicle(gateway, {"main", 2}) == vehicle("B")
    assert Store.vehicles(gateway) == [vehicle("A"), vehicle("B")]
    assert Store.vehicle(gateway, "C") == nil
  end

  test "the size of a table that a link asks for on its way waits for no scheduler" do
    gateway = start_gateway()

    for name <- [:vehicles, :vehicle_keys, :systems, :stations, :claims],
        do: assert({name, false} == {name, :ets.info(Store.table!(gateway, name), :decentralized_counters)})
  end

  test "gateways do not see each other's vehicles" do
    [one, other] = [start_gateway(), start_gateway()]
    Store.put_vehicle(one, {"main", 1}, vehicle("A"))
    assert Store.vehicles(other) == []
  end

  test "notifies watchers once per tick, with the state that holds then" do
    gateway = start_gateway()
    PubSub.subscribe(gateway, :vehicles)
    PubSub.subscribe(gateway, {:vehicle, "A"})
    for n <- 1..500, do: Store.put_vehicle(gateway, {"main", 1}, vehicle("A", %{n: n}))

    assert_receive {:fleet, {:vehicle, "A"}, "A"}
    assert_received {:fleet, :vehicles, ["A"]}
    {:message_queue_len, notices} = Process.info(self(), :message_queue_len)
    assert notices < 500

    Store.delete_vehicle(gateway, {"main", 1})
    assert_receive {:fleet, {:vehicle, "A"}, "A"}
    assert Store.vehicle(gateway, "A") == nil
  end

  test "notifies subscribers of the roster at once of vehicles that appear or are forgotten, and of nothing else" do
    gateway = start_gateway()
    PubSub.subscribe(gateway, :roster)
    for n <- 1..500, do: Store.put_vehicle(gateway, {"main", 1}, vehicle("A", %{n: n}))
    assert_received {:fleet, :roster, "A"}
    Store.delete_vehicle(gateway, {"main", 1})
    assert_received {:fleet, :roster, "A"}
    assert Store.vehicle(gateway, "A") == nil
    Store.put_vehicle(gateway, {"main", 1}, vehicle("A"))
    assert_received {:fleet, :roster, "A"}
    refute_received {:fleet, :roster, _id}
    assert Store.vehicle(gateway, "A") == vehicle("A")
  end

  test "links have snapshots and notices too" do
    gateway = start_gateway()
    PubSub.subscribe(gateway, :links)
    PubSub.subscribe(gateway, {:link, "radio"})
    Store.put_link(gateway, "radio", %{id: "radio", up: true})
    assert_receive {:fleet, :links, ["radio"]}
    assert_receive {:fleet, {:link, "radio"}, "radio"}
    assert Store.links(gateway) == [%{id: "radio", up: true}]
    Store.delete_link(gateway, "radio")
    assert Store.link(gateway, "radio") == nil
  end

  test "after unsubscribing there are no notices" do
    gateway = start_gateway()
    PubSub.subscribe(gateway, :vehicles)
    PubSub.unsubscribe(gateway, :vehicles)
    PubSub.subscribe(gateway, :links)
    Store.put_vehicle(gateway, {"main", 1}, vehicle("A"))
    Store.put_link(gateway, "l", %{})
    assert_receive {:fleet, :links, _}
    refute_received {:fleet, :vehicles, _}
  end

  test "counters start at nothing and add up over processes" do
    gateway = start_gateway()

    1..10
    |> Enum.map(fn _ -> Task.async(fn -> Store.count(gateway, :frames, 3) end) end)
    |> Task.await_many(Aerie.Patience.ms())

    assert Store.counter(gateway, :frames) == 30
    assert Store.counter(gateway, :other) == 0
    assert Store.counters(gateway)[:frames] == 30
  end

  test "what many may do, one does, until the interval is over" do
    gateway = start_gateway()

    claim = fn interval ->
      fn _ -> Task.async(fn -> Store.claim(gateway, {:beat, {"link", :peer}}, interval) end) end
    end

    assert 1..20 |> Enum.map(claim.(60_000)) |> Task.await_many(Aerie.Patience.ms()) |> Enum.count(& &1) == 1
    assert Store.claim(gateway, {:beat, {"other", :peer}}, 60_000)
    Aerie.Patience.eventually(fn -> Store.claim(gateway, {:beat, {"link", :peer}}, 1) end)
    refute Store.claim(gateway, {:beat, {"link", :peer}}, 60_000)
  end

  test "systems are bounded, known ones can still be renewed" do
    gateway = start_gateway()
    for n <- 1..4096, do: :ok = Store.see_system(gateway, {"main", n}, %{type: 6})
    assert Store.see_system(gateway, {"main", 5000}, %{type: 6}) == {:error, :too_many}
    assert Store.see_system(gateway, {"main", 7}, %{type: 2}) == :ok
    assert Store.counter(gateway, {:systems, :dropped}) == 1
    assert Store.systems(gateway)[{"main", 7}] == %{type: 2}
  end

  test "an absent gateway shows nothing and takes nothing" do
    assert Store.vehicles(make_ref()) == []
    assert Store.vehicle(make_ref(), "A") == nil
    assert Store.counters(make_ref()) == %{}
    assert_raise ArgumentError, ~r/is not running/, fn -> Store.put_link(make_ref(), "l", %{}) end
  end

  test "a link is put together from its snapshot and the rows of its peers" do
    gateway = start_gateway()
    now = System.monotonic_time(:millisecond)

    peer = fn id, heard, sources ->
      {{:peer, id}, %{peer: id, text: "10.0.0.#{id}:1", heard: heard, frames_in: id, sources: sources}}
    end

    rows = [
      peer.(1, now - 500, %{{1, 1} => %{lost: 1}}),
      peer.(2, now, %{{1, 1} => %{lost: 2}}),
      {{:source, {9, 1}}, %{lost: 9}}
    ]

    Store.put_link(gateway, "radio", %{id: "radio"}, %{put: rows, delete: []})
    assert %{id: "radio", peers: peers, sources: sources} = Links.whole(gateway, "radio")
    assert [%{peer: 1, silent_ms: silent}, %{peer: 2, frames_in: 2}] = Enum.sort_by(peers, & &1.peer)
    assert silent >= 500
    # Of one component by two peers the newest counts.
    assert sources == %{{1, 1} => %{lost: 2}, {9, 1} => %{lost: 9}}
    assert [%{peers: [_, _]}] = Links.all(gateway)

    Store.put_link(gateway, "radio", %{id: "radio"}, %{put: [], delete: [{:peer, 1}]})
    assert %{peers: [%{peer: 2}]} = Links.whole(gateway, "radio")
    Store.put_link(gateway, "radio", %{id: "radio"})
    assert %{peers: [], sources: sources} = Links.whole(gateway, "radio")
    assert sources == %{}
    Store.delete_link(gateway, "radio")
    assert Links.whole(gateway, "radio") == nil
  end

  test "without a gateway reading gives nothing, and writing raises" do
    nowhere = make_ref()
    assert Store.vehicles(nowhere) == [] and Store.links(nowhere) == [] and Store.counters(nowhere) == %{}
    assert Store.vehicle(nowhere, "A") == nil and Store.recall(nowhere, :key, :none) == :none
    assert Store.count_if_running(nowhere, :frames, 1) == :ok
    assert_raise ArgumentError, ~r/is not running/, fn -> Store.count(nowhere, :frames) end
  end

  test "what a part remembers is there after that part, until it is forgotten" do
    gateway = start_gateway()
    Task.await(Task.async(fn -> Store.remember(gateway, :part, 1) end))
    assert Store.recall(gateway, :part) == 1
    assert {:part, 1} in Store.remembered(gateway)
    Store.forget(gateway, :part)
    assert Store.recall(gateway, :part) == nil
    refute Store.starting?(gateway)
    starter = start_supervised!({Task, fn -> Process.sleep(:infinity) end})
    Store.starting(gateway, starter)
    assert Store.starting?(gateway)
    stop_supervised!(Task)
    refute Store.starting?(gateway)
  end
end
