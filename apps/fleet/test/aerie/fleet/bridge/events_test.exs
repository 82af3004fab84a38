defmodule Aerie.Fleet.Bridge.EventsTest do
  use Aerie.BridgeCase, async: true

  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir
  @moduletag :capture_log

  # Every event of every vehicle is there once, and each vehicle's are in their order.
  defp assert_complete(messages, vehicles, last) do
    for vehicle <- vehicles do
      seqs = for {^vehicle, seq, _headers} <- messages, do: seq
      assert seqs == Enum.to_list(1..last), "#{vehicle}: #{inspect(seqs, limit: :infinity)}"
    end

    assert length(messages) == length(vehicles) * last
  end

  test "an event is published once, with its id, and leaves the journal", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    conn = client(await_up(gateway))
    {:ok, _} = Gnat.sub(conn, self(), "fleet.test.*.event.>")
    _ = stream(conn, "FLEET_EVENTS")

    event =
      Event.new("VID-001", "mode_change", 7, 1_795_213_361_702_499, 99, %{"from" => "AUTO", "to" => "RTL"})

    Journal.commit(gateway, "VID-001", :state, [event])

    assert_receive {:msg, %{topic: "fleet.test.VID-001.event.mode_change", body: body, headers: headers}}

    assert {"nats-msg-id", event.id} in headers
    refute List.keymember?(headers, "aerie-backfill", 0)

    assert JSON.decode!(body) == %{
             "id" => event.id,
             "vehicle" => "VID-001",
             "type" => "mode_change",
             "seq" => 7,
             "time" => "2026-11-20T22:22:41.702Z",
             "time_boot_ms" => 99,
             "data" => %{"from" => "AUTO", "to" => "RTL"}
           }

    await_empty(gateway)
    assert [{[subject: "event.mode_change"], 1}] = samples(gateway, "gateway_nats_messages_published_total")
  end

  test "kill -9 of the server again and again while events are made: each is there once, in order", %{
    tmp_dir: dir
  } do
    gateway = start_bridge(config(dir))
    await_up(gateway)
    vehicles = for n <- 1..5, do: "V#{n}"

    # For as long as it takes: they would be done before the last kill on a busy machine.
    makers = for vehicle <- vehicles, do: {vehicle, Task.async(fn -> make(gateway, vehicle, 1) end)}

    for _ <- 1..3 do
      await(gateway, :server, &(&1[:status] == :up))
      published = metric(gateway, "gateway_nats_messages_published_total")
      eventually(fn -> metric(gateway, "gateway_nats_messages_published_total") > published + 20 end)
      restarts = Bridge.info(gateway).server.restarts
      kill9(server_pid(dir))
      await(gateway, :server, &(&1[:restarts] > restarts))
    end

    for {_vehicle, maker} <- makers, do: send(maker.pid, :enough)
    lasts = for {vehicle, maker} <- makers, do: {vehicle, Task.await(maker, Aerie.Patience.ms())}
    await_empty(gateway)
    messages = events(client(await_up(gateway)))
    for {vehicle, last} <- lasts, do: assert_complete(of(messages, vehicle), [vehicle], last)
    assert length(messages) == Enum.sum_by(lasts, &elem(&1, 1))

    assert Enum.any?(messages, fn {_, _, headers} ->
             headers =~ "Aerie-Backfill"
           end)
  end

  defp make(gateway, vehicle, seq) do
    commit(gateway, vehicle, [seq])
    receive do: (:enough -> seq), after: (5 -> make(gateway, vehicle, seq + 1))
  end

  defp of(messages, vehicle), do: for({^vehicle, _seq, _headers} = message <- messages, do: message)

  test "the bridge killed in mid-stream loses and doubles nothing", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    await_up(gateway)

    killer =
      Task.async(fn ->
        kill_parts(gateway, [:bridge_events, :bridge_connection, :bridge_state, :bridge_events])
      end)

    for seq <- 1..500, do: commit(gateway, "A", [seq])
    Task.await(killer, Aerie.Patience.ms())
    await_empty(gateway)
    assert_complete(events(client(await_up(gateway))), ["A"], 500)
  end

  defp kill_parts(gateway, roles) do
    for role <- roles do
      pid = eventually(fn -> Aerie.Base.Names.whereis(gateway, role) end)
      ref = Process.monitor(pid)
      Process.exit(pid, :kill)
      assert_receive {:DOWN, ^ref, _, _, _}
      eventually(fn -> Aerie.Base.Names.whereis(gateway, role) not in [nil, pid] end)
    end
  end

  test "without NATS events go to the disk, and after an orderly restart to the stream, marked", %{
    tmp_dir: dir
  } do
    gateway = start_bridge(config(dir, [{"nats.binary", "not-yet"}]))
    commit(gateway, "A", 1..100)
    commit(gateway, "B", 1..100)
    await(gateway, :outbox, &(&1[:events] == 200))
    stop_bridge(gateway)
    # What is committed while there is no bridge at all waits in the journal, behind the outbox.
    commit(gateway, "A", 101..110)
    start_bridge_again(gateway, config(dir))
    conn = client(await_up(gateway))
    await_empty(gateway)
    messages = events(conn)
    assert for({"A", seq, _} <- messages, do: seq) == Enum.to_list(1..110)
    assert for({"B", seq, _} <- messages, do: seq) == Enum.to_list(1..100)

    marked =
      Enum.filter(messages, fn {_, _, headers} ->
        headers =~ "Aerie-Backfill: true"
      end)

    assert length(marked) >= 200
    assert File.ls!(Path.join(dir, "outbox")) |> Enum.sort() == ["FORMAT", "head", "owner"]
  end

  test "kill -9 of the whole gateway while NATS is away: all events are on disk", %{tmp_dir: dir} do
    script = """
    Application.ensure_all_started(:fleet)
    alias Aerie.Base.PubSub
    config = Aerie.BridgeCase.settings([{"nats.url", "nats://127.0.0.1:1"}, {"outbox.dir", #{inspect(Path.join(dir, "outbox"))}}])
    {:ok, _} = Aerie.Base.Store.start_link([gateway: :g] ++ Aerie.GatewayCase.plugs(%{}))
    {:ok, _} = PubSub.start_link(gateway: :g)
    {:ok, _} = Aerie.Fleet.Bridge.Supervisor.start_link(gateway: :g, settings: config)
    PubSub.subscribe(:g, :bridge)
    # Of one vehicle, one event at a time goes to NATS.
    for n <- 1..10, vehicle = "V\#{n}" do
      events = for seq <- 1..100, do: Aerie.Vehicle.Event.new(vehicle, "statustext", seq, seq, nil, %{"n" => seq})
      Aerie.Vehicle.Events.Journal.commit(:g, vehicle, :state, events)
    end
    wait = fn wait ->
      receive do
        {:fleet, :bridge, {:outbox, %{events: 1000}}} -> IO.puts("written \#{System.pid()}")
        _ -> wait.(wait)
      end
    end
    wait.(wait)
    Process.sleep(:infinity)
    """

    {_port, pid} = other_vm(script, "written ")
    kill9(pid)

    gateway = start_bridge(config(dir))
    conn = client(await_up(gateway))
    await_empty(gateway)
    assert_complete(events(conn), for(n <- 1..10, do: "V#{n}"), 100)
  end

  test "an outbox that cannot be written is logged once; events stay in memory until NATS is back", %{
    tmp_dir: dir
  } do
    File.write!(Path.join(dir, "file"), "")
    gateway = start_bridge(config(dir, [{"outbox.dir", Path.join(dir, "file")}, {"nats.binary", "not-yet"}]))
    commit(gateway, "A", 1..10)
    assert %{problem: text} = await(gateway, :outbox, &is_binary(&1[:problem]))
    assert text =~ "cannot be kept on disk" and text =~ "stay in memory"
    assert Journal.pending_size(gateway) == 10
    stop_bridge(gateway)
    start_bridge_again(gateway, config(dir, [{"outbox.dir", Path.join(dir, "file")}]))
    await_up(gateway)
    eventually(fn -> Journal.pending_size(gateway) == 0 end)
    assert_complete(events(client(await_up(gateway))), ["A"], 10)
  end

  test "a stream that somebody deletes is made again, and what it did not take is sent again", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    conn = client(await_up(gateway))
    # Nobody looks after it before an event is refused.
    connection = Aerie.Base.Names.whereis(gateway, :bridge_connection)
    :sys.suspend(connection, Aerie.Patience.ms())
    delete_stream(conn, "FLEET_EVENTS")
    commit(gateway, "A", 1..20)
    eventually(fn -> metric(gateway, "gateway_nats_publish_errors_total") > 0 end)
    :sys.resume(connection, Aerie.Patience.ms())
    await_empty(gateway)
    assert_complete(events(conn), ["A"], 20)
  end

  test "an event that NATS can never take is dropped and does not hold up the others", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    conn = client(await_up(gateway))
    huge = Event.new("A", "statustext", 2, 2, nil, %{"text" => String.duplicate("x", 1_200_000)})
    commit(gateway, "A", [1])
    Journal.commit(gateway, "A", :state, [huge])
    commit(gateway, "A", [3])
    await_empty(gateway)
    assert for({"A", seq, _} <- events(conn), do: seq) == [1, 3]
    assert metric(gateway, "gateway_nats_events_dropped_total") == 1
  end

  test "events from before a restart go before new ones", %{tmp_dir: dir} do
    {:ok, outbox} = Outbox.open(Path.join(dir, "outbox"), max_bytes: 67_108_864, segment_bytes: 1_048_576)

    old =
      for seq <- 1..300 do
        body = JSON.encode!(%{"vehicle" => "A", "seq" => seq})
        %Outbox.Record{id: "old-#{seq}", vehicle: "A", subject: "fleet.test.A.event.statustext", body: body}
      end

    {:ok, outbox} = Outbox.append(outbox, old)
    Outbox.close(outbox)
    gateway = start_bridge(config(dir))
    commit(gateway, "A", 301..400)
    await_up(gateway)
    await_empty(gateway)
    assert_complete(events(client(await_up(gateway))), ["A"], 400)
  end

  defp samples(gateway, name) do
    Enum.find_value(Bridge.metrics(gateway), fn metric -> if metric.name == name, do: metric.samples end)
  end
end
