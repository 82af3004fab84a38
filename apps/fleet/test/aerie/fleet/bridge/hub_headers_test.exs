defmodule Aerie.Fleet.Bridge.HubHeadersTest do
  @moduledoc """
  What a vehicle's own key can do to another vehicle by the headers that nats-server obeys, and by the room that it takes: nothing. Real
  servers, with the files of `bin/nats-setup`; A attacks by its leaf, B is looked at.
  """
  use Aerie.BridgeCase, async: true

  import Aerie.ShadowCase, only: [start_shadow: 3]

  alias Aerie.{HubCase, HubServer}
  alias Aerie.TestBucket, as: KV
  alias Gnat.Jetstream.API.Stream

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    %{hub: hub, fleet: gateway, leaves: [{"A", a}, {"B", b}]} =
      dir |> HubServer.start(["A", "B"]) |> HubCase.connect(["A", "B"], [])

    start_shadow(gateway, dir, [
      {"nats.mode", "url"},
      {"nats.url", "nats://unused"},
      {"nats.streams.replicas", 1}
    ])

    {:ok, fleet} = HubServer.client(hub)
    eventually(fn -> match?({:ok, _made}, answered(fleet, fn -> KV.info(fleet, "fleet_plans") end)) end)

    # What others have at the hub.
    for bucket <- ~w(fleet_desired fleet_reported), id <- ~w(A B C) do
      :ok = answered(fleet, fn -> KV.put_value(fleet, bucket, "test.#{id}", "of " <> id) end)
    end

    for id <- ~w(B C),
        do: :ok = answered(fleet, fn -> KV.put_value(fleet, "fleet_leases", "test.vehicles.#{id}", "gw") end)

    commit(b, "B", 1..3)
    HubCase.await_stored(fleet, 3)
    aboard = fn leaf -> leaf |> await_up() |> HubServer.local_client() end
    conns = %{fleet: fleet, a: aboard.(a), b: aboard.(b)}

    for {id, conn} <- [{"A", conns.a}, {"B", conns.b}] do
      :ok = Gnat.pub(conn, "fleet.test.#{id}.state.mode", "mode of " <> id)
      eventually(fn -> state(fleet, id) == "mode of " <> id end)
    end

    conns
  end

  defp ask(conn, subject, body, headers),
    do: Gnat.request(conn, subject, body, headers: headers, receive_timeout: 5_000)

  # All that B and C have.
  defp theirs(fleet) do
    values =
      for bucket <- ~w(fleet_desired fleet_reported fleet_leases) do
        {:ok, values} = answered(fleet, fn -> KV.contents(fleet, bucket) end)
        {bucket, Map.reject(values, fn {key, _value} -> key =~ ~r/\.A$/ or key =~ "gateways" end)}
      end

    {values, state(fleet, "B"), for({"B", seq, _} <- events(fleet), do: seq)}
  end

  # The subjects of FLEET_STATE below one.
  defp subjects(fleet, filter) do
    body = JSON.encode!(%{subjects_filter: filter})

    with {:ok, %{body: text}} <- Gnat.request(fleet, "$JS.API.STREAM.INFO.FLEET_STATE", body),
         %{"state" => %{"subjects" => subjects}} <- JSON.decode!(text),
         do: {:ok, %{state: %{subjects: subjects}}}
  end

  defp state(fleet, id, group \\ "mode") do
    with {:ok, %{data: text}} <-
           answered(fleet, fn ->
             Stream.get_message(fleet, "FLEET_STATE", %{last_by_subj: "fleet.test.#{id}.state.#{group}"})
           end),
         do: text
  end

  @own [
    "hub.kv.put.fleet_desired.test.A",
    "hub.kv.put.fleet_reported.test.A",
    "hub.kv.put.fleet_leases.test.vehicles.A",
    "hub.fleet.test.A.event.statustext",
    "hub.fleet.test.gateway-A.event.gateway.started",
    "fleet.test.A.state.mode"
  ]

  @headers [
    {"Nats-Rollup", "all"},
    {"Nats-Rollup", "sub"},
    {"Nats-TTL", "1s"},
    {"Nats-TTL", "never"},
    {"Nats-Expected-Stream", "KV_fleet_desired"},
    {"Nats-Expected-Last-Sequence", "1"},
    {"Nats-Expected-Last-Msg-Id", "x"},
    {"Nats-Expected-Last-Subject-Sequence", "0"},
    {"Nats-Expected-Last-Subject-Sequence-Subject", "$KV.fleet_desired.test.B"},
    {"Nats-Incr", "+1"},
    {"Nats-Schedule", "@at 2020-01-01T00:00:00Z"},
    {"Nats-Schedule-Target", "fleet.test.B.state.mode"},
    {"Nats-Batch-Id", "b"},
    {"Nats-Marker-Reason", "Purge"},
    {"Nats-Stream-Source", "FLEET_STATE 1 > >"},
    {"Nats-Trace-Dest", "fleet.test.B.state.mode"},
    {"Nats-Msg-Id", "x"},
    {"KV-Operation", "PURGE"},
    {"Status", "503"}
  ]

  @text ~s({"vehicle":"A","seq":1})

  test "no header on anything that a vehicle may send changes what others have", context do
    %{fleet: fleet, a: a, b: b} = context
    before = theirs(fleet)

    for {{name, value} = header, n} <- Enum.with_index(@headers) do
      headers = Enum.uniq([header | beside(name)])
      for subject <- @own, do: assert({:ok, _stored_or_refused} = ask(a, subject, @text, headers), name)
      assert {header, theirs(fleet)} == {header, before}

      # What B sends now is taken.
      for {subject, stream} <- [
            {"hub.kv.put.fleet_leases.test.vehicles.B", "KV_fleet_leases"},
            {"hub.fleet.test.gateway-B.event.gateway.started", "FLEET_EVENTS_gateway-B"}
          ] do
        body = if subject =~ "leases", do: "gw", else: ~s({"vehicle":"gateway-B","seq":#{n}})
        assert {:ok, %{body: answer}} = ask(b, subject, body, [])
        assert %{"stream" => ^stream, "seq" => _} = JSON.decode!(answer), "#{name}: #{value}"
      end

      # Its own server answers for its state.
      :ok = Gnat.pub(b, "fleet.test.B.state.attitude", "#{n}")
      eventually(fn -> state(fleet, "B", "attitude") == "#{n}" end)
    end
  end

  # What the server wants beside a header.
  defp beside("Nats-Schedule-Target"), do: [{"Nats-Schedule", "@at 2020-01-01T00:00:00Z"}]
  defp beside("Nats-Batch-Id"), do: [{"Nats-Batch-Sequence", "1"}, {"Nats-Batch-Commit", "1"}]

  defp beside("Nats-Expected-Last-Subject-Sequence-Subject"),
    do: [{"Nats-Expected-Last-Subject-Sequence", "0"}]

  defp beside(_other), do: []

  test "an id that another vehicle will use (Nats-Msg-Id): its message is stored all the same", context do
    for n <- 1..5,
        subject <- @own,
        do: {:ok, _} = ask(context.a, subject, "of A", [{"Nats-Msg-Id", "B-#{n}"}])

    for n <- 1..5 do
      assert {:ok, %{body: text}} =
               ask(context.b, "hub.fleet.test.B.event.statustext", ~s({"vehicle":"B","seq":#{n}}), [
                 {"Nats-Msg-Id", "B-#{n}"}
               ])

      assert %{"stream" => "FLEET_EVENTS_B", "seq" => _} = answer = JSON.decode!(text)
      refute answer["duplicate"]
    end
  end

  test "a vehicle that fills all it can reaches its own bound, and takes nobody's room", context do
    %{fleet: fleet, a: a} = context
    before = theirs(fleet)
    big = String.duplicate("x", 900_000)

    assert ask(a, "hub.fleet.test.A.event.invented", "x", []) == {:error, :no_responders}

    # Its own server has those, the hub has not; by progress nobody reaches a stream either.
    for subject <- ["state.invented", "state.x.progress.y", "event.x.progress.y", "raw"],
        do: :ok = Gnat.pub(a, "fleet.test.A." <> subject, "x")

    for group <- Bridge.Message.state_groups() do
      :ok = Gnat.pub(a, "fleet.test.A.state.#{group}", String.duplicate("x", 32_768))
      :ok = Gnat.pub(a, "fleet.test.A.state.#{group}", big)
    end

    # The stream stores them in order, some after the answer to a later request.
    groups = Enum.sort(for group <- Bridge.Message.state_groups(), do: "fleet.test.A.state." <> group)

    eventually(fn ->
      {:ok, %{state: %{subjects: subjects}}} = answered(fleet, fn -> subjects(fleet, "fleet.test.A.>") end)
      Enum.sort(Map.keys(subjects || %{})) == groups
    end)

    {:ok, %{state: %{bytes: bytes}}} = answered(fleet, fn -> Stream.info(fleet, "FLEET_STATE") end)
    assert bytes < 1_048_576 * Bridge.Hub.Quota.of(1).state_mb

    for bucket <- ["desired.test.A", "reported.test.A", "leases.test.vehicles.A"] do
      assert {:ok, %{body: refused}} = ask(a, "hub.kv.put.fleet_" <> bucket, big, [])
      assert refused =~ "maximum"
    end

    for _ <- 1..90,
        do:
          {:ok, _} = ask(a, "hub.fleet.test.A.event.statustext", ~s({"vehicle":"A","seq":1,"x":"#{big}"}), [])

    {:ok, %{state: %{bytes: bytes}, config: %{max_bytes: max}}} =
      answered(fleet, fn -> Stream.info(fleet, "FLEET_EVENTS_A") end)

    assert bytes <= max
    assert theirs(fleet) == before
  end

  test "a bucket and a stream that an earlier version made are changed to this", %{fleet: fleet, tmp_dir: dir} do
    old = %{
      Aerie.Fleet.Nats.KV.stream("fleet_leases", max_bytes: 1_048_576)
      | allow_rollup_hdrs: true,
        duplicate_window: 120_000_000_000
    }

    {:ok, _} = answered(fleet, fn -> Stream.update(fleet, old) end)

    {:ok, %{config: state}} = answered(fleet, fn -> Stream.info(fleet, "FLEET_STATE") end)

    {:ok, _} =
      answered(fleet, fn -> Stream.update(fleet, %{state | max_msg_size: -1, allow_rollup_hdrs: true}) end)

    hub =
      start_bridge(
        HubServer.gateway(%{
          set: HubServer.set(dir),
          dir: Path.join(dir, "again"),
          hosts: ["127.0.0.1"],
          ports: ports(dir)
        })
      )

    await_up(hub)

    start_shadow(hub, Path.join(dir, "again"), [
      {"nats.mode", "url"},
      {"nats.url", "nats://unused"},
      {"nats.streams.replicas", 1}
    ])

    for stream <- ~w(FLEET_STATE KV_fleet_leases) do
      eventually(fn ->
        {:ok, %{config: config}} = answered(fleet, fn -> Stream.info(fleet, stream) end)

        config.allow_rollup_hdrs in [false, nil] and config.max_msg_size > 0 and
          config.duplicate_window == 100_000_000
      end)
    end
  end

  defp ports(dir) do
    %{"ports" => ports} = dir |> HubServer.set() |> Path.join("fleet.json") |> File.read!() |> JSON.decode!()
    Map.new(ports, fn {name, port} -> {String.to_existing_atom(name), port} end)
  end
end
