defmodule Aerie.Fleet.HealthTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Fleet.Health

  @moduletag :tmp_dir
  @moduletag :capture_log

  test "ready depends on events being stored, not on the connection", %{tmp_dir: dir} do
    gateway = make_ref()
    # Nobody listens there.
    nats = %{url: ["nats://127.0.0.1:1"], retry_min_ms: 60_000, retry_max_ms: 60_000}

    Aerie.GatewayCase.start_gateway(%{nats: nats, outbox: %{dir: dir}},
      name: gateway,
      with: [:bridge, :router]
    )

    # And says why, once it has tried.
    why = "cannot connect to NATS at nats://127.0.0.1:1: "
    eventually(fn -> match?({false, %{nats: %{problem: ^why <> _reason}}}, Health.ready(gateway)) end)
    # The first retry is at once; the next one is a minute later.
    connection = Aerie.Base.Names.whereis(gateway, :bridge_connection)
    eventually(fn -> :sys.get_state(connection, Aerie.Patience.ms()).machine.attempts >= 2 end)

    tables = Tables.get(gateway)
    put = &Tables.put_info(gateway, tables, &1, &2)
    put.(:connection, %{status: :up, conn: nil, streams: :ok, url: "nats://127.0.0.1:1"})
    # On a busy machine its own loops are late for a moment.
    eventually(fn ->
      match?({true, %{status: "ready", nats: %{connected: true, problem: nil}}}, Health.ready(gateway))
    end)

    # Ready means ready: not while code is loaded, which delays frames.
    loader = spawn_link(fn -> receive(do: (:loaded -> :ok)) end)
    :ok = Aerie.Base.Store.starting(gateway, loader)
    assert {false, %{problems: ["the gateway still starts" <> _]}} = Health.ready(gateway)
    send(loader, :loaded)
    eventually(fn -> match?({true, _report}, Health.ready(gateway)) end)

    put.(:connection, %{status: :up, conn: nil, streams: :error, url: "nats://127.0.0.1:1"})
    put.(:streams, %{result: :error, report: %{"FLEET_EVENTS" => {:error, "no room"}}})

    assert {false, %{nats: %{connected: true, problem: "stream FLEET_EVENTS: no room"}}} =
             Health.ready(gateway)

    put.(:connection, %{status: :up, conn: nil, streams: :ok, url: "nats://127.0.0.1:1"})
    put.(:outbox, %{events: 3, problem: nil, stalled: "NATS does not confirm events", silent?: true})
    assert {false, %{nats: %{problem: problem, hub: nil}}} = Health.ready(gateway)
    assert problem =~ "disk of nats-server at nats://127.0.0.1:1 was full, make room and restart it"
    put.(:outbox, %{events: 0, problem: nil, stalled: nil, silent?: false})

    # Events are stored aboard, so the leaf node is ready, and says what its hub lacks.
    put.(:hub, %{status: :up, waiting: 4, lost: 0, problem: "restart it", stalled: "restart it"})

    hub = %{connected: true, stores: false, waiting: 4, problem: "restart it"}

    eventually(fn ->
      with {true, %{nats: %{hub: %{} = shown}}} <- Health.ready(gateway),
           do: Map.take(shown, Map.keys(hub)) == hub,
           else: (_late -> false)
    end)
  end

  test "the gateway's own loops stand still: not ready, with the name of each, until they answer again" do
    config = %{mavlink: %{heartbeat_deadman_s: 0.6}}
    gateway = Aerie.GatewayCase.start_gateway(config, with: [:bridge, :router, :links])
    eventually(fn -> match?({true, %{problems: []}}, Health.ready(gateway)) end)

    for role <- [:router_sweeper, :pubsub] do
      stuck = Aerie.Base.Names.whereis(gateway, role)
      :ok = :sys.suspend(stuck, Aerie.Patience.ms())

      eventually(fn ->
        with {false, %{status: "not ready", problems: [text]}} <- Health.ready(gateway),
             do: text =~ "#{role} does not answer",
             else: (_yet -> false)
      end)

      :ok = :sys.resume(stuck, Aerie.Patience.ms())
      eventually(fn -> match?({true, %{problems: []}}, Health.ready(gateway)) end)
    end
  end
end
