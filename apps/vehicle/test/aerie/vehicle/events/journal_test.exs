defmodule Aerie.Vehicle.Events.JournalTest do
  use Aerie.GatewayCase, async: true

  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Event

  defp event(seq, vehicle \\ "A"),
    do: Event.new(vehicle, "statustext", seq, seq * 1000, nil, %{"text" => "#{seq}"})

  test "a commit keeps the state and the events, and tells who listens" do
    gateway = start_gateway()
    PubSub.subscribe(gateway, :events)
    PubSub.subscribe(gateway, :journal)
    assert Journal.state(gateway, "A") == nil
    [one, two] = [event(1), event(2)]
    :ok = Journal.commit(gateway, "A", %{seq: 2}, [one, two])

    assert Journal.state(gateway, "A") == %{seq: 2}
    assert Journal.pending(gateway) == [one, two]
    assert_received {:fleet, :events, ^one}
    assert_received {:fleet, :events, ^two}
    assert_received {:fleet, :journal, :pending}
  end

  test "acknowledged events are pending no more but still recent; unknown ids are nothing" do
    gateway = start_gateway()
    events = for seq <- 1..3, do: event(seq)
    Journal.commit(gateway, "A", :state, events)
    Journal.ack(gateway, [Enum.at(events, 1).id, "nonsense"])
    Journal.ack(gateway, [Enum.at(events, 1).id])
    assert Journal.pending(gateway) == [Enum.at(events, 0), Enum.at(events, 2)]
    assert Journal.pending_size(gateway) == 2
    assert Journal.pending(gateway, 1) == [hd(events)]
    assert Journal.recent(gateway, "A") == events
  end

  test "events of several vehicles are pending in the order of their commits" do
    gateway = start_gateway()
    for seq <- 1..20, vehicle <- ["B", "A"], do: Journal.commit(gateway, vehicle, seq, [event(seq, vehicle)])

    assert Enum.map(Journal.pending(gateway), &{&1.seq, &1.vehicle}) ==
             for(s <- 1..20, v <- ["B", "A"], do: {s, v})

    assert length(Journal.recent(gateway, "B")) == 20
  end

  test "recent events of all vehicles are in the order of time; since gives the first, none the last ones" do
    gateway = start_gateway()
    for vehicle <- ["B", "A"], seq <- 1..300, do: Journal.commit(gateway, vehicle, seq, [event(seq, vehicle)])
    of = fn events -> Enum.map(events, &{&1.seq, &1.vehicle}) end
    all = for seq <- 45..300, vehicle <- ["A", "B"], do: {seq, vehicle}

    assert of.(Journal.recent(gateway, :all, limit: 10_000)) == all
    assert of.(Journal.recent(gateway, :all, limit: 3)) == Enum.take(all, -3)

    assert of.(Journal.recent(gateway, :all, since: 100_000, limit: 3)) == [
             {100, "A"},
             {100, "B"},
             {101, "A"}
           ]

    assert of.(Journal.recent(gateway, "A", since: 299_000)) == [{299, "A"}, {300, "A"}]
    assert of.(Journal.recent(gateway, "A", limit: 1)) == [{300, "A"}]
    assert Journal.recent(gateway, :all, since: 300_001) == []
    assert Journal.recent(gateway, "nobody") == []
  end

  test "both lists are bounded, and what is dropped is the oldest and counted" do
    gateway = start_gateway(%{limits: %{max_pending_events: 1_000}})

    for chunk <- Enum.chunk_every(1..1_005, 100),
        do: Journal.commit(gateway, "A", :s, Enum.map(chunk, &event/1))

    pending = Journal.pending(gateway)
    assert length(pending) == 1_000
    assert hd(pending).seq == 6
    assert Store.counter(gateway, {:journal, :pending_dropped}) == 5
    recent = Journal.recent(gateway, "A")
    assert {length(recent), hd(recent).seq} == {256, 750}
  end

  test "the inbox gives what the committed state has not taken account of" do
    gateway = start_gateway()
    for n <- ~w(a b c)a, do: Journal.offer(gateway, "A", n)
    Journal.offer(gateway, "B", :other)
    assert Journal.inbox(gateway, "A", 0) == [{1, :a}, {2, :b}, {3, :c}]
    assert Journal.inbox(gateway, "A", 2) == [{3, :c}]
    Journal.forget(gateway, "A", [1, 2])
    assert Journal.inbox(gateway, "A", 0) == [{3, :c}]
  end

  test "a full inbox drops the newest, counted, and takes more when it was read" do
    gateway = start_gateway()
    for n <- 1..4096, do: :ok = Journal.offer(gateway, "A", n)
    assert Journal.offer(gateway, "A", :late) == {:error, :full}
    assert Store.counter(gateway, {:journal, :inbox_dropped}) == 1
    assert Store.counter(gateway, {:vehicle, "A", :inbox_dropped}) == 1
    assert Store.counter(gateway, {:vehicle, "B", :inbox_dropped}) == 0
    Journal.forget(gateway, "A", Enum.to_list(1..100))
    assert Journal.offer(gateway, "A", :fits) == :ok
    assert List.last(Journal.inbox(gateway, "A", 4000)) |> elem(1) == :fits
  end

  test "texts fill half of the inbox, urgent ones three quarters: what happens to the vehicle has room" do
    gateway = start_gateway()
    text = fn severity -> Journal.offer(gateway, "A", %{kind: :text, data: %{severity: severity}}) end
    assert 4096 - Enum.count(1..4096, fn _ -> text.(6) == {:error, :full} end) == 2048
    assert 4096 - Enum.count(1..4096, fn _ -> text.(0) == {:error, :full} end) == 1024
    assert Journal.offer(gateway, "A", %{kind: :params}) == {:error, :full}
    assert Journal.offer(gateway, "A", %{kind: :state}) == :ok
  end

  test "parameters are remembered with the step that saw them" do
    gateway = start_gateway()
    assert Journal.param(gateway, "A", "RTL_ALT") == :error
    Journal.commit(gateway, "A", :s, [], %{"RTL_ALT" => 1500.0})
    assert Journal.param(gateway, "A", "RTL_ALT") == {:ok, 1500.0}
    assert Journal.param(gateway, "B", "RTL_ALT") == :error
  end

  test "names of parameters are bounded; known ones can still change" do
    gateway = start_gateway()

    for chunk <- Enum.chunk_every(1..8300, 50),
        do: Journal.commit(gateway, "A", :s, [], Map.new(chunk, &{"P#{&1}", 1}))

    assert Store.counter(gateway, {:journal, :params_dropped}) == 8300 - 8192
    assert Journal.param(gateway, "A", "P8300") == :error
    Journal.commit(gateway, "A", :s, [], %{"P1" => 2})
    assert Journal.param(gateway, "A", "P1") == {:ok, 2}
    Journal.forget_vehicle(gateway, "A")
    assert Journal.param(gateway, "A", "P1") == :error
    Journal.commit(gateway, "A", :s, [], %{"P8300" => 3})
    assert Journal.param(gateway, "A", "P8300") == {:ok, 3}
  end

  test "the same transition has the same id, any other a different one" do
    assert event(1).id == event(1).id
    assert length(Enum.uniq_by([event(1), event(2), event(1, "B")], & &1.id)) == 3
    assert event(1).id =~ ~r/\A[0-9a-f]{32}\z/
    assert_raise FunctionClauseError, fn -> Event.new("A", "no such type", 1, 0, nil, %{}) end
  end
end
