defmodule Aerie.Fleet.Bridge.State.LastPublishedTest do
  @moduledoc "Lives of a gateway that follow each other: what the next one knows of the last."
  use Aerie.BridgeCase, async: true

  alias Aerie.Base.Json
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Fleet.Bridge.State.LastPublished.File, as: Kept
  alias Aerie.Vehicle.Events.Journal
  alias MavCodec.Messages.Heartbeat

  @moduletag :tmp_dir
  @moduletag :capture_log

  # A copter of ArduPilot: base mode with or without the armed bit, custom mode, system status.
  defp heartbeat(:flying),
    do: %Heartbeat{type: 2, autopilot: 3, base_mode: 0xD1, custom_mode: 3, system_status: 4}

  defp heartbeat(:landed),
    do: %Heartbeat{type: 2, autopilot: 3, base_mode: 0x51, custom_mode: 9, system_status: 3}

  defp start_gateway(config) do
    Aerie.GatewayCase.start_gateway(config, with: [:bridge, :router, :links], pubsub_tick_ms: 10)
  end

  defp hear(gateway, what) do
    port =
      eventually(fn ->
        match?(%{status: s} when s != :down, Store.link(gateway, "radio")) and
          Store.link(gateway, "radio")[:port]
      end)

    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
    mode = %{flying: "AUTO", landed: "LAND"}[what]

    eventually(fn ->
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, MavCodec.encode(heartbeat(what), system: 7))
      Process.sleep(50)
      match?(%{groups: %{mode: %{data: %{mode: ^mode}}}}, Store.vehicle(gateway, {"main", 7}))
    end)

    Store.vehicle(gateway, {"main", 7}).id
  end

  defp gateway_config(dir) do
    %{
      environment: "test",
      nats: %{port: 0, store_dir: Path.join(dir, "nats"), retry_min_ms: 20, retry_max_ms: 200},
      outbox: %{dir: Path.join(dir, "outbox")},
      # It is not lost, however late a busy machine hears it again.
      timeouts: %{vehicle_lost_s: 600},
      links: [%{id: "radio", url: "udpin:127.0.0.1:0", enabled: true}]
    }
  end

  defp connect(gateway) do
    eventually(fn -> match?(%{problem: nil}, Bridge.info(gateway)) end)
    client(eventually(fn -> Bridge.login_url(gateway) end))
  end

  # All events of the stream as their bodies.
  defp bodies(conn) do
    %{state: %{first_seq: first, last_seq: last}} = stream(conn, "FLEET_EVENTS")

    for seq <- max(first, 1)..last//1 do
      by = %{seq: seq}

      {:ok, message} =
        answered(conn, fn -> Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_EVENTS", by) end)

      {JSON.decode!(message.data), message.subject}
    end
  end

  defp kept(dir) do
    case File.read(Path.join(dir, "outbox/last/vehicles.json")) do
      {:ok, text} -> JSON.decode!(text)
      {:error, _} -> %{"vehicles" => %{}}
    end
  end

  test "armed and flying before, down and disarmed now: found, not seen, in a new epoch", %{tmp_dir: dir} do
    config = gateway_config(dir)
    first = start_gateway(config)
    id = hear(first, :flying)

    eventually(fn ->
      match?(%{"armed" => true, "mode" => "AUTO", "in_air" => true}, kept(dir)["vehicles"][id])
    end)

    stop_supervised!({Aerie.Gateway, first})

    second = start_gateway(config)
    assert ^id = hear(second, :landed)
    conn = connect(second)

    found =
      Aerie.Patience.eventually(
        fn ->
          found = for {%{"data" => %{"found" => true}} = body, _subject} <- bodies(conn), do: body
          length(found) == 3 && found
        end,
        fn -> "three changes were found: #{inspect({bodies(conn), waiting(second)}, limit: 200)}" end
      )

    assert Enum.map(found, & &1["type"]) == ["mode_change", "landed", "disarmed"]
    assert Enum.map(found, & &1["seq"]) == [1, 2, 3]

    starts = for {%{"type" => "gateway.started"} = body, subject} <- bodies(conn), do: {body, subject}
    name = LastPublished.name(MavRouter.Identity.Settings.from(config))
    assert [{one, subject}, {two, subject}] = starts
    assert subject == "fleet.test.#{name}.event.gateway.started"
    assert two["epoch"] > one["epoch"]
    assert one["data"]["previous_epoch"] == nil and one["data"]["ended"] == nil
    assert two["data"]["previous_epoch"] == one["epoch"] and two["data"]["ended"] == "orderly"
    assert two["data"]["vehicles"] == [id]
    assert Enum.all?(found, &(&1["epoch"] == two["epoch"]))

    # The state says it too.
    state = "fleet.test.#{id}.state.mode"
    eventually(fn -> JSON.decode!(last(conn, "FLEET_STATE", state).data)["epoch"] == two["epoch"] end)
  end

  test "kill -9 keeps it too, and is reported", %{tmp_dir: dir} do
    script = """
    Application.ensure_all_started(:fleet)
    Application.put_env(:vehicle, :gateway_parts, [Aerie.ControlParts, Aerie.FleetParts])
    {:ok, _} = Aerie.GatewayCase.start_link(#{inspect(gateway_config(dir))}, name: :g, with: [:bridge, :router, :links])
    await = fn await -> case Aerie.Base.Store.link(:g, "radio") do
      %{port: port} when is_integer(port) -> port
      _ -> Process.sleep(20); await.(await)
    end end
    IO.puts("port \#{await.(await)} \#{System.pid()}")
    Process.sleep(:infinity)
    """

    {_port, line} = other_vm(script, "port ")
    [port, pid] = String.split(line)
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])
    frame = MavCodec.encode(heartbeat(:flying), system: 7)

    [{id, _}] =
      eventually(fn ->
        :ok = :gen_udp.send(socket, {127, 0, 0, 1}, String.to_integer(port), frame)
        Process.sleep(50)
        found = Enum.filter(kept(dir)["vehicles"], fn {_id, known} -> known["armed"] end)
        found != [] && found
      end)

    kill9(pid)
    gateway = start_gateway(gateway_config(dir))
    assert ^id = hear(gateway, :landed)
    conn = connect(gateway)
    types = fn -> for {%{"data" => %{"found" => true}} = body, _} <- bodies(conn), do: body["type"] end
    eventually(fn -> types.() == ["mode_change", "landed", "disarmed"] end)

    assert %{"ended" => "killed"} =
             List.last(for {%{"type" => "gateway.started"} = b, _} <- bodies(conn), do: b["data"])
  end

  test "a transition whose event is not published yet does not count as published", %{tmp_dir: dir} do
    config = config(dir)
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})}, id: :store)
    start_supervised!({PubSub, gateway: gateway}, id: :pubsub)
    memory = start_supervised!({LastPublished, gateway: gateway, settings: config})
    detector = %{detector() | last: %{armed: true}}
    :ok = Journal.commit(gateway, "A", detector, [])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == true

    event = Event.new("A", "disarmed", 1, 1, nil, %{})
    :ok = Journal.commit(gateway, "A", %{detector | last: %{armed: false}}, [event])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == true
    :ok = Journal.ack(gateway, [event.id])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == false
  end

  test "a notice of the journal brings a look, for a change with an event or without one", %{tmp_dir: dir} do
    gateway = start_memory(dir)
    options = Aerie.Vehicle.Options.new(config(dir).vehicle, {"main", 7})
    Store.put_vehicle(gateway, options.key, %{id: options.id, key: options.key, links: []})
    start_supervised!({Aerie.Vehicle.Events, gateway: gateway, options: options})
    # Where a vehicle is found is no event.
    see(gateway, options, %{armed: true, in_air: true, mode: "AUTO"})
    assert types(gateway, options.id) == []
    eventually(fn -> match?(%{"armed" => true}, kept(dir)["vehicles"][options.id]) end)

    see(gateway, options, %{armed: false, in_air: true, mode: "AUTO"})
    Journal.ack(gateway, for(event <- Journal.pending(gateway), do: event.id))
    eventually(fn -> match?(%{"armed" => false}, kept(dir)["vehicles"][options.id]) end)
  end

  test "the time at which values still hold is updated in place, not for what waits or is lost", %{
    tmp_dir: dir
  } do
    file = Path.join(dir, "outbox/last/vehicles.json")
    gateway = start_memory(dir)
    memory = Aerie.Base.Names.whereis(gateway, :bridge_last_published)

    for id <- ["A", "B", "C"],
        do: Journal.commit(gateway, id, %{detector() | vehicle: id, last: %{armed: true}}, [])

    look(memory)
    :ok = Journal.commit(gateway, "B", %{detector() | vehicle: "B", last: %{armed: true}, lost: true}, [])
    event = Event.new("C", "disarmed", 1, 1, nil, %{})
    :ok = Journal.commit(gateway, "C", %{detector() | vehicle: "C", last: %{armed: false}}, [event])
    look(memory)
    written = File.stat!(file)
    before = Kept.read(file).vehicles

    # As if ten seconds had passed.
    :sys.replace_state(memory, &%{&1 | written_at: &1.written_at - 10_000_000})
    at = System.os_time(:microsecond)
    look(memory)
    assert %{inode: inode, size: size, mode: mode} = File.stat!(file)
    assert {inode, size, mode} == {written.inode, written.size, written.mode}

    assert %{"A" => %{since: since, armed: true}, "B" => %{lost: true} = b, "C" => %{armed: true} = c} =
             Kept.read(file).vehicles

    assert since >= at and since > before["A"].since
    assert {b, c} == {before["B"], before["C"]}

    # A file that was removed is made again, whole.
    File.rm!(file)
    :sys.replace_state(memory, &%{&1 | written_at: &1.written_at - 10_000_000})
    look(memory)
    assert %{"A" => %{armed: true}} = Kept.read(file).vehicles
  end

  test "a vehicle of a recording is not kept", %{tmp_dir: dir} do
    gateway = start_memory(dir)
    Store.put_link(gateway, "file", %{id: "file", spec: %{recorded: true}})
    Store.put_vehicle(gateway, {"main", 1}, %{id: "A", links: ["file"]})

    for id <- ["A", "B"],
        do: Journal.commit(gateway, id, %{detector() | vehicle: id, last: %{armed: true}}, [])

    look(Aerie.Base.Names.whereis(gateway, :bridge_last_published))
    assert %{"B" => %{"armed" => true}} = vehicles = kept(dir)["vehicles"]
    refute is_map_key(vehicles, "A")
  end

  test "of a vehicle that is lost, what is known holds since it was heard", %{tmp_dir: dir} do
    gateway = start_memory(dir)
    memory = Aerie.Base.Names.whereis(gateway, :bridge_last_published)
    lost = %{detector() | last: %{armed: true}}
    :ok = Journal.commit(gateway, "A", lost, [])
    look(memory)
    since = kept(dir)["vehicles"]["A"]["since"]
    :ok = Journal.commit(gateway, "A", %{lost | lost: true}, [])
    look(memory)
    stop_supervised!(gateway)
    assert %{"vehicles" => %{"A" => %{"since" => ^since}}, "ended" => true} = kept(dir)
  end

  test "what is kept of a vehicle that is not heard again stays, and damage costs no start", %{tmp_dir: dir} do
    file = Path.join(dir, "outbox/last/vehicles.json")
    File.mkdir_p!(Path.dirname(file))
    since = System.os_time(:microsecond)
    vehicles = %{"B" => %{"armed" => true, "mode" => 7, "since" => since}, "C" => "nonsense"}
    File.write!(file, JSON.encode!(%{"epoch" => 17, "vehicles" => vehicles}))
    gateway = start_memory(dir)
    assert LastPublished.of(gateway, "B") == %{armed: true, since: since}
    assert LastPublished.of(gateway, "C") == nil
    stop_supervised!(gateway)
    assert %{"vehicles" => %{"B" => %{"armed" => true, "since" => ^since}}, "ended" => true} = kept(dir)

    for damaged <- ["", "{", "[]", ~s({"epoch": "x", "vehicles": {}}), <<0, 255>>] do
      File.write!(file, damaged)
      gateway = start_memory(dir)
      assert LastPublished.of(gateway, "B") == nil
      stop_supervised!(gateway)
    end
  end

  test "known before and not heard again: lost, marked as found, once; restored when it is heard", %{
    tmp_dir: dir
  } do
    file = Path.join(dir, "outbox/last/vehicles.json")
    File.mkdir_p!(Path.dirname(file))
    since = System.os_time(:microsecond) - 60_000_000
    known = fn lost -> %{"armed" => true, "since" => since, "lost" => lost} end

    # Of D an older version has not kept whether it was lost.
    vehicles = %{
      "A" => known.(false),
      "B" => known.(true),
      "C" => known.(false),
      "D" => %{"armed" => true, "since" => since}
    }

    File.write!(file, JSON.encode!(%{"epoch" => 17, "vehicles" => vehicles}))
    # Long enough for C to be heard in time on a busy machine.
    gateway = start_memory(dir, [{"timeouts.vehicle_lost_s", 15.0}, {"timeouts.vehicle_stale_s", 1.0}])
    memory = Aerie.Base.Names.whereis(gateway, :bridge_last_published)
    # C is heard again in time.
    assert %{vehicle: "C"} = Journal.begin(gateway, "C", %{detector() | vehicle: "C"})

    assert [event] =
             eventually(fn ->
               look(memory)
               told = for %{type: "link.lost"} = event <- Journal.pending(gateway), do: event
               told != [] && told
             end)

    assert %{vehicle: "A", seq: 1, data: %{"found" => true, "silent_s" => silent} = data} = event
    assert silent >= 60.0 and data["since"] == Json.time(since)
    assert [^event] = for(%{type: "link.lost"} = event <- Journal.pending(gateway), do: event)

    # It is kept as lost once that is published, and its values are still compared.
    Journal.ack(gateway, Enum.map(Journal.pending(gateway), & &1.id))
    look(memory)
    assert %{"lost" => true, "armed" => true, "since" => ^since} = kept(dir)["vehicles"]["A"]
    told = Journal.begin(gateway, "A", detector())
    digest = %{armed: false, mode: "LAND"}

    assert {%{lost: false}, [%{type: "link.restored", seq: 2}, %{type: "disarmed", data: %{"found" => true}}],
            _} =
             Aerie.Vehicle.Events.Detector.observe(
               told,
               Aerie.Vehicle.Events.Detector.Observation.new(
                 :state,
                 System.os_time(:microsecond),
                 nil,
                 digest
               )
             )

    stop_supervised!(gateway)
    again = start_memory(dir, [{"timeouts.vehicle_lost_s", 0.2}, {"timeouts.vehicle_stale_s", 0.1}])
    memory = Aerie.Base.Names.whereis(again, :bridge_last_published)

    # C was heard in that life and is not in this one.
    eventually(fn -> look(memory).unheard == %{} end)
    assert ["C"] = for(%{type: "link.lost", vehicle: id} <- Journal.pending(again), do: id)
  end

  test "the folder of another gateway is used once that one has ended; the log says so once", %{tmp_dir: dir} do
    first = start_memory(dir)
    known = %{detector() | last: %{armed: true, in_air: true, mode: "AUTO"}}
    options = Aerie.Vehicle.Options.new(config(dir).vehicle, {"main", 7})
    for id <- ["A", options.id], do: Journal.commit(first, id, %{known | vehicle: id}, [])
    look(Aerie.Base.Names.whereis(first, :bridge_last_published))
    before = Journal.epoch(first)

    {second, log} =
      ExUnit.CaptureLog.with_log(fn ->
        # Its start is not told before it has the folder, however long that takes.
        second = start_memory(dir, [], begin_ms: 3_600_000)
        memory = Aerie.Base.Names.whereis(second, :bridge_last_published)
        assert %{"epoch" => ^before} = kept(dir)
        # One vehicle is heard before the folder is free. It has landed, and was seen to be disarmed.
        Store.put_vehicle(second, options.key, %{id: options.id, key: options.key, links: []})
        start_supervised!({Aerie.Vehicle.Events, gateway: second, options: options})
        see(second, options, %{armed: true, in_air: false, mode: "AUTO"})
        see(second, options, %{armed: false, in_air: false, mode: "AUTO"})
        assert types(second, options.id) == ["disarmed"]
        # Locked still: the next attempts fail without a word.
        for _ <- 1..3, do: send(memory, :lock)
        look(memory)
        assert %{"epoch" => ^before} = kept(dir)
        refute Journal.state(second, LastPublished.name(config(dir).vehicle.identity))

        stop_supervised!(first)
        send(memory, :lock)
        eventually(fn -> types(second, options.id) == ["disarmed", "landed"] end)
        second
      end)

    assert length(String.split(log, "will not be found until")) == 2
    assert %{armed: true, mode: "AUTO"} = LastPublished.of(second, "A")
    look(Aerie.Base.Names.whereis(second, :bridge_last_published))
    epoch = Journal.epoch(second)
    assert epoch > before
    assert %{"epoch" => ^epoch, "ended" => false, "vehicles" => %{"A" => %{"armed" => true}}} = kept(dir)

    assert [%{data: %{"previous_epoch" => ^before, "ended" => "orderly"}}] =
             Journal.recent(second, LastPublished.name(config(dir).vehicle.identity))

    assert [%{data: %{"found" => true}}] =
             for(%{type: "landed"} = event <- Journal.recent(second, options.id), do: event)
  end

  test "a gateway that does not get the folder publishes its start all the same", %{tmp_dir: dir} do
    _first = start_memory(dir)
    second = start_memory(dir)
    send(Aerie.Base.Names.whereis(second, :bridge_last_published), :begin)
    look(Aerie.Base.Names.whereis(second, :bridge_last_published))

    assert [%{type: "gateway.started", data: %{"previous_epoch" => nil}}] =
             Journal.recent(second, LastPublished.name(config(dir).vehicle.identity))
  end

  test "an epoch is greater than the last one although the clock is not", %{tmp_dir: dir} do
    file = Path.join(dir, "outbox/last/vehicles.json")
    File.mkdir_p!(Path.dirname(file))
    far = System.os_time(:millisecond) + 1_000_000_000
    File.write!(file, JSON.encode!(%{"epoch" => far, "vehicles" => %{}}))
    assert Journal.epoch(start_memory(dir)) == far + 1
  end

  defp start_memory(dir, settings \\ [], more \\ []) do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})}, id: {:store, gateway})
    start_supervised!({PubSub, gateway: gateway}, id: {:pubsub, gateway})
    options = [gateway: gateway, settings: config(dir, settings)] ++ more
    start_supervised!({LastPublished, options}, id: gateway)
    gateway
  end

  defp detector,
    do: Aerie.Vehicle.Events.Detector.new(%{id: "A", battery_low: 0.2, battery_critical: 0.1})

  defp see(gateway, options, digest) do
    observation =
      Aerie.Vehicle.Events.Detector.Observation.new(:state, System.os_time(:microsecond), nil, digest)

    :ok = Journal.offer(gateway, options.id, observation)
    events = Aerie.Base.Names.whereis(gateway, :events, options.key)
    Aerie.Vehicle.Events.wake(events)
    :sys.get_state(events, Aerie.Patience.ms())
  end

  defp types(gateway, id), do: for(event <- Journal.recent(gateway, id), do: event.type)

  defp look(memory) do
    send(memory, :look)
    :sys.get_state(memory, Aerie.Patience.ms())
  end
end
