defmodule Aerie.Fleet.BridgeTest do
  use Aerie.BridgeCase, async: true

  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir
  @moduletag :capture_log

  describe "embedded mode" do
    test "a server comes up, with both streams and their limits", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      conn = client(await_up(gateway))

      assert %{config: state} = stream(conn, "FLEET_STATE")

      assert %{subjects: ["fleet.*.*.state.>"], max_msgs_per_subject: 1, discard: :old, max_bytes: 67_108_864} =
               state

      # Values that change several times a second would wear out a flash card.
      assert state.storage == :memory

      assert %{config: events} = stream(conn, "FLEET_EVENTS")

      assert %{subjects: ["fleet.*.*.event.>"], max_bytes: 536_870_912, discard: :old, storage: :file} =
               events

      assert events.max_age == 30 * 86_400 * 1_000_000_000
      assert events.duplicate_window == 3600 * 1_000_000_000

      assert %{mode: :embedded, connected: true, server: %{status: :up, port: port}} = Bridge.info(gateway)
      assert port > 0
      assert %{"FLEET_EVENTS" => :created, "FLEET_STATE" => :created} = Bridge.info(gateway).streams
    end

    test "a default port that is taken: the next free one is used", %{tmp_dir: dir} do
      {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
      {:ok, taken} = :inet.port(socket)
      config = config(dir)
      config = %{config | nats: %{config.nats | port: taken}, port_given: false}
      gateway = start_bridge(config)
      await_up(gateway)
      assert Bridge.info(gateway).server.port in (taken + 1)..(taken + 100)
    end

    test "a configured port that is taken is reported, and retried until it is free", %{tmp_dir: dir} do
      {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
      {:ok, taken} = :inet.port(socket)
      gateway = start_bridge(config(dir, [{"nats.port", taken}]))
      assert %{status: {:failed, text}} = await(gateway, :server, &match?(%{status: {:failed, _}}, &1))
      assert text == "nats.port #{taken} cannot be opened: address already in use"
      :gen_tcp.close(socket)
      assert bare(await_up(gateway)) == "nats://127.0.0.1:#{taken}"
    end

    test "a missing program is one clear line, and the gateway goes on", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir, [{"nats.binary", "no-such-nats-server"}]))
      assert %{status: {:failed, text}} = await(gateway, :server, &match?(%{status: {:failed, _}}, &1))
      assert text =~ "cannot find the program no-such-nats-server"
      commit(gateway, "A", 1..3)
      await(gateway, :outbox, &(&1[:events] == 3))
      assert Journal.pending_size(gateway) == 0
    end

    test "two gateways do not share a folder", %{tmp_dir: dir} do
      await_up(start_bridge(config(dir)))
      second = start_bridge(config(dir))
      assert %{status: {:failed, text}} = await(second, :server, &match?(%{status: {:failed, _}}, &1))
      assert text =~ "in use by another gateway"
    end

    test "the server ends with the bridge, and its data is there at the next start", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      await_up(gateway)
      pid = server_pid(dir)
      commit(gateway, "A", 1..5)
      await_empty(gateway)
      stop_bridge(gateway)
      eventually(fn -> Aerie.Base.Files.FolderLock.start_time(pid) == "" end)
      start_bridge_again(gateway, config(dir))
      conn = client(await_up(gateway))
      assert Enum.map(events(conn), &elem(&1, 1)) == [1, 2, 3, 4, 5]
    end

    test "a server that an earlier gateway left behind is ended first", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      await_up(gateway)
      old = server_pid(dir)
      # As after a kill -9 of the shell in between and of the gateway at once: the server's end tells nobody.
      stop_bridge(gateway)
      conf = Path.join(dir, "nats/nats.conf")

      leftover =
        Port.open({:spawn_executable, System.find_executable("nats-server")}, [
          :binary,
          :stderr_to_stdout,
          args: ["-c", conf]
        ])

      orphan = eventually(fn -> server_pid(dir) not in [old, ""] && server_pid(dir) end)
      start_bridge_again(gateway, config(dir))
      await_up(gateway)
      eventually(fn -> Aerie.Base.Files.FolderLock.start_time(orphan) == "" end)
      assert server_pid(dir) != orphan
      if Port.info(leftover), do: Port.close(leftover)
    end
  end

  describe "a configured server" do
    test "is used, and its loss and return are survived", %{tmp_dir: dir} do
      owner = start_bridge(config(Path.join(dir, "server")))
      url = await_up(owner)
      gateway = start_bridge(config(dir, [{"nats.url", url}, {"nats.mode", "url"}]))
      assert await_up(gateway) == bare(url)
      assert %{mode: :url, server: nil, streams: %{"FLEET_STATE" => :ok}} = Bridge.info(gateway)
      old = Bridge.connection(gateway)
      kill9(server_pid(Path.join(dir, "server")))
      commit(gateway, "A", 1..10)
      assert await_reconnected(gateway, old) == bare(url)
      await_empty(gateway)
      assert Enum.map(events(client(url)), &elem(&1, 1)) == Enum.to_list(1..10)
    end

    test "that has other limits keeps them, and the difference is reported", %{tmp_dir: dir} do
      owner = start_bridge(config(Path.join(dir, "server")))
      url = await_up(owner)

      gateway =
        start_bridge(config(dir, [{"nats.url", url}, {"nats.mode", "url"}, {"nats.streams.event_max_mb", 7}]))

      await_up(gateway)

      assert {:differs, ["max_bytes is 536870912, configured 7340032"]} =
               Bridge.info(gateway).streams["FLEET_EVENTS"]
    end

    test "of our own is changed instead", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      await_up(gateway)
      stop_bridge(gateway)
      start_bridge_again(gateway, config(dir, [{"nats.streams.event_max_mb", 7}]))
      conn = client(await_up(gateway))
      assert %{config: %{max_bytes: 7_340_032}} = stream(conn, "FLEET_EVENTS")
    end
  end

  defp home(conn) do
    case Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_STATE", %{last_by_subj: "fleet.test.V.state.home"}) do
      {:ok, %{data: data}} -> JSON.decode!(data)["data"]["n"]
      _none -> nil
    end
  end

  describe "state" do
    test "goes to its subject at once, and the stream keeps the last", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      conn = client(await_up(gateway))
      {:ok, _} = Gnat.sub(conn, self(), "fleet.test.VID-001.state.>")
      _ = stream(conn, "FLEET_STATE")

      group = %{at: 0, time_boot_ms: 123, data: %{lat: 1.5, alt_rel: :nan, name: "a\xFF"}}
      :ok = Bridge.publish_state(gateway, "VID-001", :position, group, 1_795_213_361_702_499)
      assert_receive {:msg, %{topic: "fleet.test.VID-001.state.position", body: body}}

      assert JSON.decode!(body) == %{
               "vehicle" => "VID-001",
               "group" => "position",
               "gateway" => Bridge.name(gateway),
               "time" => "2026-11-20T22:22:41.702Z",
               "time_boot_ms" => 123,
               "data" => %{"lat" => 1.5, "alt_rel" => nil, "name" => "a\uFFFD"}
             }

      for n <- 1..20, do: Bridge.publish_state(gateway, "VID-001", :position, %{n: n}, n)
      wait_for_last(20)
      assert %{state: %{messages: 1}} = stream(conn, "FLEET_STATE")

      # What was sent is counted a moment after it arrived.
      eventually(fn ->
        published = metric(gateway, "gateway_nats_messages_published_total")
        (published + metric(gateway, "gateway_nats_state_superseded_total")) in 21..22
      end)
    end

    test "while NATS is away: the last value per subject, published when it is back", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir, [{"nats.binary", "not-yet"}]))
      await(gateway, :server, &match?(%{status: {:failed, _}}, &1))
      for n <- 1..50, group <- [:position, :mode], do: Bridge.publish_state(gateway, "V", group, %{n: n}, n)
      assert metric(gateway, "gateway_nats_state_superseded_total") == 98
      # Two values and two marks, whatever came.
      assert :ets.info(Bridge.Status.Tables.get(gateway).values, :size) == 4
      stop_bridge(gateway)

      # Back: the same, with a connection that comes late.
      owner = start_bridge(config(Path.join(dir, "server")))
      url = await_up(owner)
      conn = client(url)
      {:ok, _} = Gnat.sub(conn, self(), "fleet.test.V.state.>")
      _ = stream(conn, "FLEET_STATE")
      pid = server_pid(Path.join(dir, "server"))
      start_bridge_again(gateway, config(dir, [{"nats.url", url}, {"nats.mode", "url"}]))
      await_up(gateway)
      Process.unlink(conn)
      old = Bridge.connection(gateway)
      kill9(pid)
      for n <- 1..50, do: Bridge.publish_state(gateway, "V", :gps, %{n: n}, n)
      await_reconnected(gateway, old)
      conn = client(url)

      last = fn ->
        case Gnat.Jetstream.API.Stream.get_message(conn, "FLEET_STATE", %{
               last_by_subj: "fleet.test.V.state.gps"
             }) do
          {:ok, %{data: data}} -> JSON.decode!(data)["data"]["n"]
          _ -> nil
        end
      end

      assert eventually(last) == 50
    end

    test "a new stream gets all values, however old: after a restart of the server, and in a new place",
         %{tmp_dir: dir} do
      gateway = start_bridge(config(dir, [{"nats.streams.state_storage", "file"}]))
      conn = client(await_up(gateway))
      assert %{config: %{storage: :file}} = stream(conn, "FLEET_STATE")
      :ok = Bridge.publish_state(gateway, "V", :home, %{n: 1}, 0)
      eventually(fn -> home(conn) == 1 end)
      Process.unlink(conn)
      stop_bridge(gateway)

      # The values on the disk go with the stream.
      start_bridge_again(gateway, config(dir))
      conn = client(await_up(gateway))
      assert %{config: %{storage: :memory}} = stream(conn, "FLEET_STATE")
      :ok = Bridge.publish_state(gateway, "V", :home, %{n: 2}, 0)
      eventually(fn -> home(conn) == 2 end)
      # As if it had been sent long ago.
      sent = Bridge.Status.Tables.get(gateway).sent
      eventually(fn -> :ets.info(sent, :size) == 1 end)
      [{subject, message, at}] = :ets.tab2list(sent)
      :ets.insert(sent, {subject, message, at - 3_600_000})
      Process.unlink(conn)
      old = Bridge.connection(gateway)
      kill9(server_pid(dir))
      await_reconnected(gateway, old)
      conn = client(await_up(gateway))
      assert eventually(fn -> home(conn) end) == 2
    end

    test "a new stream that another gateway made gets all values", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir))
      conn = client(await_up(gateway))
      :ok = Bridge.publish_state(gateway, "V", :home, %{n: 1}, 0)
      eventually(fn -> home(conn) == 1 end)

      # As the server's own gateway does where another one made the stream before it, on disk.
      %{config: there} = stream(conn, "FLEET_STATE")
      :ok = delete_stream(conn, "FLEET_STATE")
      {:ok, _made} = Gnat.Jetstream.API.Stream.create(conn, %{there | storage: :memory})
      send(Aerie.Base.Names.whereis(gateway, :bridge_connection), :check_streams)
      assert eventually(fn -> home(conn) end) == 1
    end

    test "without a bridge is nothing" do
      assert Bridge.publish_state(make_ref(), "V", :position, %{}, 0) == :ok
      assert Enum.all?(Bridge.metrics(make_ref()), &(&1.samples == []))
      assert Bridge.info(make_ref()) == nil
    end
  end

  defp wait_for_last(n) do
    assert_receive {:msg, %{body: body}}
    unless JSON.decode!(body)["data"]["n"] == n, do: wait_for_last(n)
  end
end
