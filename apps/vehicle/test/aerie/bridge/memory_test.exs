defmodule Aerie.Bridge.MemoryTest do
  @moduledoc "Lives of a gateway that follow each other: what the next one knows of the last."
  use Aerie.BridgeCase, async: true

  alias Aerie.Bridge.Memory
  alias MavCodec.Messages.Heartbeat

  @moduletag :tmp_dir
  @moduletag :capture_log

  # A copter of ArduPilot: base mode with or without the armed bit, custom mode, system status.
  defp heartbeat(:flying),
    do: %Heartbeat{type: 2, autopilot: 3, base_mode: 0xD1, custom_mode: 3, system_status: 4}

  defp heartbeat(:landed),
    do: %Heartbeat{type: 2, autopilot: 3, base_mode: 0x51, custom_mode: 9, system_status: 3}

  defp start_gateway(config) do
    gateway = make_ref()
    start_supervised!({Aerie.Gateway, name: gateway, config: config, pubsub_tick_ms: 10}, id: gateway)
    gateway
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
    config(dir, [
      {"mavlink.local_addr", "off"},
      {"sockets.enabled", false},
      {"links", [%{"id" => "radio", "url" => "udpin:127.0.0.1:0"}]}
    ])
  end

  defp connect(gateway) do
    eventually(fn -> match?(%{problem: nil}, Bridge.info(gateway)) end)
    client(Bridge.login_url(gateway))
  end

  # All events of the stream as their bodies.
  defp bodies(conn) do
    {:ok, %{state: %{first_seq: first, last_seq: last}}} =
      Gnat.Jetstream.API.Stream.info(conn, "FLEET_EVENTS")

    for seq <- max(first, 1)..last//1 do
      {:ok, message} = Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_EVENTS", %{seq: seq})
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

    stop_supervised!(first)

    second = start_gateway(config)
    assert ^id = hear(second, :landed)
    conn = connect(second)

    found =
      eventually(fn ->
        found = for {%{"data" => %{"found" => true}} = body, _subject} <- bodies(conn), do: body
        length(found) == 3 && found
      end)

    assert Enum.map(found, & &1["type"]) == ["mode_change", "landed", "disarmed"]
    assert Enum.map(found, & &1["seq"]) == [1, 2, 3]

    starts = for {%{"type" => "gateway.started"} = body, subject} <- bodies(conn), do: {body, subject}
    name = Memory.name(config)
    assert [{one, subject}, {two, subject}] = starts
    assert subject == "fleet.test.#{name}.event.gateway.started"
    assert two["epoch"] > one["epoch"]
    assert one["data"]["previous_epoch"] == nil and one["data"]["ended"] == nil
    assert two["data"]["previous_epoch"] == one["epoch"] and two["data"]["ended"] == "orderly"
    assert two["data"]["vehicles"] == [id]
    assert Enum.all?(found, &(&1["epoch"] == two["epoch"]))

    # The state says it too.
    {:ok, message} =
      Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_STATE", %{
        last_by_subj: "fleet.test.#{id}.state.mode"
      })

    assert JSON.decode!(message.data)["epoch"] == two["epoch"]
  end

  test "kill -9 keeps it too, and is told", %{tmp_dir: dir} do
    script = """
    Application.ensure_all_started(:vehicle)
    alias Aerie.{Config, Fleet, Store}
    alias Aerie.Store.PubSub
    config = Config.default([{"nats.port", 0}, {"nats.store_dir", #{inspect(Path.join(dir, "nats"))}},
      {"environment", "test"}, {"outbox.dir", #{inspect(Path.join(dir, "outbox"))}}, {"mavlink.local_addr", "off"},
      {"sockets.enabled", false}, {"links", [%{"id" => "radio", "url" => "udpin:127.0.0.1:0"}]}])
    {:ok, _} = Aerie.Gateway.start_link(name: :g, config: config)
    await = fn await -> case Store.link(:g, "radio") do
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

  test "a transition whose event is not out yet is not taken for told", %{tmp_dir: dir} do
    config = config(dir)
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.Gateway.plugs(%{})}, id: :store)
    start_supervised!({PubSub, gateway: gateway}, id: :pubsub)
    memory = start_supervised!({Memory, gateway: gateway, config: config})
    detector = %{detector() | last: %{armed: true}}
    :ok = Fleet.Journal.commit(gateway, "A", detector, [])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == true

    event = Event.new("A", "disarmed", 1, 1, nil, %{})
    :ok = Fleet.Journal.commit(gateway, "A", %{detector | last: %{armed: false}}, [event])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == true
    :ok = Fleet.Journal.ack(gateway, [event.id])
    look(memory)
    assert kept(dir)["vehicles"]["A"]["armed"] == false
  end

  test "a vehicle of a recording is not kept: it is not out there", %{tmp_dir: dir} do
    gateway = start_memory(dir)
    Store.put_link(gateway, "file", %{id: "file", kind: :replay})
    Store.put_vehicle(gateway, {"main", 1}, %{id: "A", links: ["file"]})

    for id <- ["A", "B"],
        do: Fleet.Journal.commit(gateway, id, %{detector() | vehicle: id, last: %{armed: true}}, [])

    look(Aerie.Names.whereis(gateway, :bridge_memory))
    assert %{"B" => %{"armed" => true}} = vehicles = kept(dir)["vehicles"]
    refute is_map_key(vehicles, "A")
  end

  test "of a vehicle that is lost, what is known holds since it was heard", %{tmp_dir: dir} do
    gateway = start_memory(dir)
    memory = Aerie.Names.whereis(gateway, :bridge_memory)
    lost = %{detector() | last: %{armed: true}}
    :ok = Fleet.Journal.commit(gateway, "A", lost, [])
    look(memory)
    since = kept(dir)["vehicles"]["A"]["since"]
    :ok = Fleet.Journal.commit(gateway, "A", %{lost | lost: true}, [])
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
    assert Memory.of(gateway, "B") == %{armed: true, since: since}
    assert Memory.of(gateway, "C") == nil
    stop_supervised!(gateway)
    assert %{"vehicles" => %{"B" => %{"armed" => true, "since" => ^since}}, "ended" => true} = kept(dir)

    for damaged <- ["", "{", "[]", ~s({"epoch": "x", "vehicles": {}}), <<0, 255>>] do
      File.write!(file, damaged)
      gateway = start_memory(dir)
      assert Memory.of(gateway, "B") == nil
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
    gateway = start_memory(dir, [{"timeouts.vehicle_lost_s", 0.2}, {"timeouts.vehicle_stale_s", 0.1}])
    memory = Aerie.Names.whereis(gateway, :bridge_memory)
    # C is heard again in time.
    assert %{vehicle: "C"} = Fleet.Journal.begin(gateway, "C", %{detector() | vehicle: "C"})

    assert [event] =
             eventually(fn ->
               look(memory)
               told = for %{type: "link.lost"} = event <- Fleet.Journal.pending(gateway), do: event
               told != [] && told
             end)

    assert %{vehicle: "A", seq: 1, data: %{"found" => true, "silent_s" => silent} = data} = event
    assert silent >= 60.0 and data["since"] == Fleet.Json.time(since)
    assert [^event] = for(%{type: "link.lost"} = event <- Fleet.Journal.pending(gateway), do: event)

    # It is kept as lost once it is told, and what was known of it goes on to be compared.
    Fleet.Journal.ack(gateway, Enum.map(Fleet.Journal.pending(gateway), & &1.id))
    look(memory)
    assert %{"lost" => true, "armed" => true, "since" => ^since} = kept(dir)["vehicles"]["A"]
    told = Fleet.Journal.begin(gateway, "A", detector())
    digest = %{armed: false, mode: "LAND"}

    assert {%{lost: false}, [%{type: "link.restored", seq: 2}, %{type: "disarmed", data: %{"found" => true}}],
            _} =
             Aerie.Vehicle.Detector.observe(told, {:state, System.os_time(:microsecond), nil, digest})

    stop_supervised!(gateway)
    again = start_memory(dir, [{"timeouts.vehicle_lost_s", 0.2}, {"timeouts.vehicle_stale_s", 0.1}])
    memory = Aerie.Names.whereis(again, :bridge_memory)

    # C was heard in that life and is not in this one.
    eventually(fn -> look(memory).unheard == %{} end)
    assert ["C"] = for(%{type: "link.lost", vehicle: id} <- Fleet.Journal.pending(again), do: id)
  end

  test "an epoch is greater than the last one although the clock is not", %{tmp_dir: dir} do
    file = Path.join(dir, "outbox/last/vehicles.json")
    File.mkdir_p!(Path.dirname(file))
    far = System.os_time(:millisecond) + 1_000_000_000
    File.write!(file, JSON.encode!(%{"epoch" => far, "vehicles" => %{}}))
    assert Fleet.Journal.epoch(start_memory(dir)) == far + 1
  end

  defp start_memory(dir, settings \\ []) do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.Gateway.plugs(%{})}, id: {:store, gateway})
    start_supervised!({PubSub, gateway: gateway}, id: {:pubsub, gateway})
    start_supervised!({Memory, gateway: gateway, config: config(dir, settings)}, id: gateway)
    gateway
  end

  defp detector,
    do: Aerie.Vehicle.Detector.new(%{id: "A", battery_low: 0.2, battery_critical: 0.1})

  defp look(memory) do
    send(memory, :look)
    :sys.get_state(memory)
  end
end
