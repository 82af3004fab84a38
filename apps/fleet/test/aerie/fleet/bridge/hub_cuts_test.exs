defmodule Aerie.Fleet.Bridge.HubCutsTest do
  @moduledoc """
  Leaf nodes over every cut: real servers. Each test counts what the hub's stream has in the end: every event of every vehicle once
  and in its order. The long ones print their figures.
  """
  use Aerie.BridgeCase, async: true

  import Aerie.HubCase

  alias Aerie.HubServer
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.TestBucket, as: KV

  @moduletag :tmp_dir
  @moduletag :capture_log
  @unshare System.cmd("unshare", ["-rm", "true"], stderr_to_stdout: true) |> elem(1) == 0

  defp now, do: System.monotonic_time(:millisecond)

  # Killed, away for a while in which 40 events are made for each vehicle, and back.
  defp gone(dir, vehicles, away_ms) do
    # Clients end with their server.
    Process.flag(:trap_exit, true)
    %{hub: hub, leaves: leaves} = start(dir, vehicles)
    make(leaves, 1..10)
    await_all(conn(hub), leaves, 10)
    HubServer.kill(hub)
    for {_id, leaf} <- leaves, do: await(leaf, :hub, &(&1[:status] == :down))

    for n <- 11..50 do
      make(leaves, n..n)
      if away_ms > 0, do: Process.sleep(div(away_ms, 40))
    end

    for {id, leaf} <- leaves,
        do: :ok = Bridge.publish_state(leaf, id, :mode, %{name: "RTL"}, 1_700_000_000_000_000)

    await_aboard(leaves)
    # The vehicle's own NATS goes on, and says how much waits.
    for {_id, leaf} <- leaves do
      await(leaf, :hub, &(&1[:status] == :down and &1[:waiting] >= 40))
      eventually(fn -> Bridge.info(leaf).problem == nil end)
    end

    HubServer.restart(hub)
    begun = now()
    for {_id, leaf} <- leaves, do: await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0))
    converged = now() - begun
    conn = conn(hub)
    await_all(conn, leaves, 50)
    forget_news()
    make(leaves, 51..51)
    await_all(conn, leaves, 51)
    # Unless the hub was away for its gateway once more, which happens on a busy machine.
    steady = for {id, leaf} <- leaves, not away?(leaf), do: id

    for {id, rows} <- arrived(conn, names(vehicles)) do
      late = for {seq, true} <- rows, do: seq
      assert {id, Enum.to_list(11..50) -- late} == {id, []}
      if id in steady, do: refute(51 in late)
      state = "fleet.test.#{id}.state.mode"
      eventually(fn -> (last(conn, "FLEET_STATE", state).hdrs || "") =~ "Aerie-Backfill: true" end)
    end

    converged
  end

  defp away?(leaf) do
    receive do
      {:news, ^leaf, :hub, %{status: :down}} -> true
      {:news, ^leaf, :outbox, %{events: n}} when n > 0 -> true
      {:news, ^leaf, _part, _info} -> away?(leaf)
    after
      0 -> false
    end
  end

  test "the hub is gone: events wait aboard, arrive once, in order and marked; the last value too", %{
    tmp_dir: dir
  } do
    assert gone(dir, 2, 0) >= 0
  end

  @tag :long
  test "the hub is gone for half a minute, with 20 vehicles", %{tmp_dir: dir} do
    ms = gone(dir, 20, 30_000)
    IO.puts("20 vehicles, hub gone 30 s: 800 events late, 0 lost, 0 doubled, converged in #{ms} ms")
  end

  @tag :soak
  @tag timeout: 3_600_000
  test "the hub is gone for ten minutes, with 20 vehicles", %{tmp_dir: dir} do
    ms = gone(dir, 20, 600_000)
    IO.puts("20 vehicles, hub gone 10 min: 800 events late, 0 lost, 0 doubled, converged in #{ms} ms")
  end

  test "the leaf's server is killed, then its whole bridge restarts while the hub is away", %{tmp_dir: dir} do
    Process.flag(:trap_exit, true)
    %{hub: hub, leaves: [{id, leaf}] = leaves} = start(dir, 1)
    make(leaves, 1..10)
    kill9(server_pid(Path.join(dir, id)))
    make(leaves, 11..20)
    await_all(conn(hub), leaves, 20)
    HubServer.kill(hub)
    await(leaf, :hub, &(&1[:status] == :down))
    make(leaves, 21..30)
    await_aboard(leaves)
    stop_bridge(leaf)
    start_bridge_again(leaf, HubServer.leaf(hub, id))
    make(leaves, 31..40)
    await_aboard(leaves)
    HubServer.restart(hub)
    await_stored(conn(hub), 40)

    await_all(conn(hub), leaves, 40)
  end

  test "somebody deletes the hub's stream: its gateway makes it again, and what comes then is there", %{
    tmp_dir: dir
  } do
    %{hub: hub, leaves: [{id, leaf}] = leaves} = start(dir, 1)
    make(leaves, 1..10)
    conn = conn(hub)
    await_all(conn, leaves, 10)
    delete_stream(conn, "FLEET_EVENTS_#{id}")
    make(leaves, 11..20)
    await_aboard(leaves)
    await_stored(conn, 10)
    await(leaf, :hub, &(&1[:waiting] == 0))
    assert for({^id, seq, _} <- events(conn), do: seq) == Enum.to_list(11..20)
  end

  test "the local stream overflows while the hub is away: a marker stands where events are missing", %{
    tmp_dir: dir
  } do
    Process.flag(:trap_exit, true)
    hub = HubServer.start(dir, ["V1"])
    start_bridge(HubServer.gateway(hub)) |> await_up()
    leaf = start_bridge(HubServer.leaf(hub, "V1", [{"nats.streams.event_max_mb", 1}]), epoch: 1)
    HubServer.await_hub(leaf)

    big = fn seq ->
      Event.new("V1", "statustext", seq, seq, nil, %{"text" => String.duplicate("x", 20_000)})
    end

    :ok = Journal.commit(leaf, "V1", :some_state, Enum.map(1..5, big))
    eventually(fn -> metric(leaf, "gateway_hub_events_confirmed_total") >= 5 end)
    HubServer.kill(hub)
    await(leaf, :hub, &(&1[:status] == :down))
    for n <- 6..100, do: :ok = Journal.commit(leaf, "V1", :some_state, [big.(n)])
    await_empty(leaf)
    HubServer.restart(hub)
    %{lost: lost} = await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0 and &1[:lost] > 0))
    conn = conn(hub)
    rows = for({"V1", seq, _} <- events(conn), do: seq)

    assert [1, 2, 3, 4, 5, nil, first | rest] = rows
    assert [first | rest] == Enum.to_list(first..100)
    assert lost == first - 6 and lost > 0

    %{data: marker} = last(conn, "FLEET_EVENTS_V1", "fleet.test.V1.event.events.lost")
    to = first - 1

    assert %{"type" => "events.lost", "seq" => nil, "data" => %{"from" => 6, "to" => ^to, "lost" => ^lost}} =
             JSON.decode!(marker)

    assert metric(leaf, "gateway_hub_events_lost_total") == lost
  end

  test "the vehicle's clock jumps an hour forth and back: every event once, in order, no marker", %{
    tmp_dir: dir
  } do
    %{hub: hub, leaves: [{id, leaf}] = leaves} = start(dir, 1)
    hour = 3_600_000_000

    for {seq, jump} <- Enum.zip(1..30, Stream.cycle([0, hour, -hour])) do
      event = Event.new(id, "statustext", seq, 1_700_000_000_000_000 + seq + jump, seq, %{"n" => seq})
      :ok = Journal.commit(leaf, id, :some_state, [event])
    end

    await_all(conn(hub), leaves, 30)
  end

  @tag skip: not @unshare && "no namespaces here"
  test "the hub's disk is full: nothing is confirmed, nothing is lost", %{tmp_dir: dir} do
    Process.flag(:trap_exit, true)
    %{hub: hub, fleet: fleet, leaves: [{_id, leaf}] = leaves} = start(dir, 1, disk_mb: 8)
    make(leaves, 1..10)
    await_all(conn(hub), leaves, 10)
    filler = HubServer.fill_disk(hub)
    make(leaves, 11..600)
    await_aboard(leaves)
    commit(fleet, "G", 1..3)
    # Both gateways are connected, and say which server is to be restarted.
    assert %{status: :up, waiting: waiting, stalled: aboard} = await(leaf, :hub, & &1[:stalled])
    assert waiting > 0 and aboard =~ "disk of the hub's nats-server was full, make room and restart it"
    eventually(fn -> Bridge.info(leaf).problem == nil end)
    await(fleet, :outbox, & &1[:silent?])
    %{problem: problem, url: url} = Bridge.info(fleet)
    assert problem =~ "NATS does not confirm events: if the disk of nats-server at #{url} was full"

    assert [%{severity: :error, mend: "If the disk of the hub's" <> _}] =
             told(leaf, :hub_not_confirming)

    assert [%{mend: "If the disk of nats-server at tls://" <> _}] = told(fleet, :nats_not_confirming)
    File.rm!(filler)
    # A server whose write failed stores nothing until it is started again.
    HubServer.end_and_start(hub)
    conn = conn(hub)
    await_stored(conn, 603)
    assert %{"V1" => rows, "G" => late} = arrived(conn, ["V1", "G"])

    assert {for({seq, _late} <- rows, do: seq), for({seq, _late} <- late, do: seq)} ==
             {Enum.to_list(1..600), [1, 2, 3]}

    assert %{stalled: nil, problem: nil} = await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0))
    eventually(fn -> Bridge.info(fleet).problem == nil end)
    assert {told(leaf, :hub_not_confirming), told(fleet, :nats_not_confirming)} == {[], []}
  end

  test "three servers, three copies: the leader of the stream is killed", %{tmp_dir: dir} do
    Process.flag(:trap_exit, true)
    %{hub: hub, fleet: fleet, leaves: leaves} = start(dir, 2, servers: 3)
    make(leaves, 1..20)
    conn = conn(hub)
    url = [{"nats.mode", "url"}, {"nats.url", "nats://unused"}, {"nats.streams.replicas", 3}]
    Aerie.ShadowCase.start_shadow(fleet, dir, url)

    for bucket <- ~w(desired reported leases plans) do
      eventually(fn ->
        info = Aerie.Fleet.Nats.call(conn, fn -> KV.info(conn, "fleet_" <> bucket) end)
        match?({:ok, %{config: %{num_replicas: 3, allow_direct: true}}}, info)
      end)
    end

    await_all(conn, leaves, 20)
    assert %{config: %{num_replicas: 3}} = stream(conn, "FLEET_EVENTS_V1")
    leader = eventually(fn -> with "" <- stream(conn, "FLEET_EVENTS_V1").cluster["leader"], do: nil end)
    make(leaves, 21..40)
    HubServer.kill(hub, leader)
    make(leaves, 41..60)
    begun = now()
    alive = Enum.find(hub.hosts, &(&1 != leader))
    conn = conn(hub, alive)
    for {_id, leaf} <- leaves, do: await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0))
    await_all(conn, leaves, 60)
    assert now() >= begun
    %{cluster: %{"leader" => other}} = stream(conn, "FLEET_EVENTS_V1")
    refute other == leader
  end
end
