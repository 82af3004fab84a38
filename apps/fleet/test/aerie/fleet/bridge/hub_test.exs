defmodule Aerie.Fleet.Bridge.HubTest do
  @moduledoc "A hub with the files of `bin/nats-setup`, and companions as its leaf nodes: real servers, TLS, nkeys."
  use Aerie.BridgeCase, async: true

  alias Aerie.HubServer
  alias Aerie.TestBucket, as: KV
  alias Gnat.Jetstream.API.Stream

  @moduletag :tmp_dir
  @moduletag :capture_log
  @nobody {:error, :no_responders}

  # The hub's gateway makes the streams; the buckets are those of the shadow.
  setup %{tmp_dir: dir} do
    hub = HubServer.start(dir, ["A", "B"])
    start_bridge(HubServer.gateway(hub)) |> await_up()
    {:ok, fleet} = HubServer.client(hub)

    for bucket <- ~w(fleet_desired fleet_reported fleet_leases),
        do: {:ok, _} = answered(fleet, fn -> Stream.create(fleet, Aerie.Fleet.Nats.KV.stream(bucket, [])) end)

    a = start_bridge(HubServer.leaf(hub, "A"))
    HubServer.await_hub(a)
    %{hub: hub, fleet: fleet, a: a, client: HubServer.local_client(await_up(a))}
  end

  defp ask(conn, subject, body \\ "", headers \\ [], ms \\ Aerie.Patience.ms()),
    do: Gnat.request(conn, subject, body, headers: headers, receive_timeout: ms)

  # What may have no answer, or is asked again without one.
  defp try_to_ask(conn, subject), do: ask(conn, subject, "", [], 10_000)

  # All that was sent before on the way from the leaf to the hub has arrived.
  defp flush(client), do: assert({:ok, _info} = ask(client, "hub.info"))

  test "a companion is itself: state, events, commands, its own keys", %{fleet: fleet, client: client, a: a} do
    {:ok, _} = Gnat.sub(fleet, self(), "fleet.test.A.>")
    :ok = answered(fleet, fn -> KV.put_value(fleet, "fleet_desired", "test.A", "wish") end)
    :ok = Bridge.publish_state(a, "A", :mode, %{name: "HOLD"}, 1_700_000_000_000_000)
    assert_receive {:msg, %{topic: "fleet.test.A.state.mode"}}
    commit(a, "A", 1..3)
    for _ <- 1..3, do: assert_receive({:msg, %{topic: "fleet.test.A.event.statustext"}})
    eventually(fn -> for({"A", seq, _} <- events(fleet), do: seq) == [1, 2, 3] end)

    assert {:ok, %{body: "wish"}} = ask(client, "hub.kv.get.fleet_desired.test.A")

    assert {:ok, %{body: "{\"stream\":\"KV_fleet_reported\"" <> _}} =
             ask(client, "hub.kv.put.fleet_reported.test.A", "{}")

    answering(client, "fleet.test.A.cmd.*", "done")
    eventually(fn -> match?({:ok, %{body: "done"}}, try_to_ask(fleet, "fleet.test.A.cmd.arm")) end)
  end

  test "its JetStream is a domain of its own, and the hub's is another one", %{fleet: fleet, client: client} do
    info = fn conn, prefix ->
      {:ok, %{body: body}} = ask(conn, prefix <> ".API.INFO")
      JSON.decode!(body)
    end

    assert %{"domain" => "A", "streams" => aboard} = info.(client, "$JS")
    assert %{"domain" => "A"} = info.(client, "$JS.A")
    assert %{"domain" => hub, "streams" => streams} = info.(fleet, "$JS")
    assert hub != "A" and aboard > 0 and streams > 0
    # From the fleet nobody reaches the streams aboard.
    assert {:error, :no_responders} = ask(fleet, "$JS.A.API.INFO")
  end

  defp answering(client, subject, body) do
    test = self()

    start_supervised!(
      {Task,
       fn ->
         {:ok, _} = Gnat.sub(client, self(), subject)
         send(test, {:listening, subject})
         answer(client, body, test)
       end},
      id: make_ref()
    )

    assert_receive {:listening, ^subject}
  end

  defp answer(client, body, test) do
    receive do
      {:msg, message} ->
        send(test, {:seen, message.topic})
        if message.reply_to, do: Gnat.pub(client, message.reply_to, body)
        answer(client, body, test)
    end
  end

  test "it cannot publish as another one, not even by way of JetStream's answers", %{
    fleet: fleet,
    client: client
  } do
    {:ok, _} = Gnat.sub(fleet, self(), ">")
    assert ask(client, "hub.fleet.test.B.event.armed", "{}") == @nobody
    assert ask(client, "hub.fleet.test.gateway-B.event.gateway.started", "{}") == @nobody
    assert ask(client, "hub.kv.put.fleet_reported.test.B", "{}") == @nobody
    assert ask(client, "hub.kv.put.fleet_desired.test.B", "{}") == @nobody

    for subject <- [
          "fleet.test.B.state.mode",
          "fleet.test.B.event.armed",
          "fleet.other.A.state.mode",
          "$KV.fleet_desired.test.B"
        ],
        do: :ok = Gnat.pub(client, subject, "forged")

    # Its own text, as the answer to a request that names another one's subject.
    assert {:ok, _} = ask(client, "hub.kv.put.fleet_desired.test.A", "forged")
    :ok = Gnat.pub(client, "hub.kv.get.fleet_desired.test.A", "", reply_to: "fleet.test.B.event.armed")
    :ok = Gnat.pub(client, "hub.kv.get.fleet_desired.test.A", "", reply_to: "hub.fleet.test.B.event.armed")
    flush(client)
    :ok = Gnat.pub(client, "fleet.test.A.state.mode", "last")
    assert_receive {:msg, %{topic: "fleet.test.A.state.mode"}}
    refute_received {:msg, %{topic: "fleet.test.B" <> _}}
    refute_received {:msg, %{topic: "fleet.other" <> _}}

    for stream <- ["FLEET_STATE" | event_streams(fleet)],
        do:
          assert(
            {:error, %{"code" => 404}} =
              answered(fleet, fn -> Stream.get_message(fleet, stream, %{last_by_subj: "fleet.test.B.>"}) end)
          )

    assert {:none, 0} = answered(fleet, fn -> Aerie.Fleet.Nats.KV.get(fleet, "fleet_desired", "test.B") end)
  end

  test "of the leases it has its own vehicle's only: nobody's sign of life, and no other vehicle's owner",
       context do
    %{fleet: fleet, client: client} = context

    for key <- ~w(test.gateways.f00d test.vehicles.B test.vehicles.A),
        do: :ok = answered(fleet, fn -> KV.put_value(fleet, "fleet_leases", key, "true") end)

    for key <-
          ~w(test.gateways.f00d test.gateways.gateway-A test.gateways.new test.vehicles.B prod.vehicles.A) do
      assert ask(client, "hub.kv.put.fleet_leases.#{key}", "forged") == @nobody
      assert ask(client, "hub.kv.get.fleet_leases.#{key}") == @nobody
      :ok = Gnat.pub(client, "$KV.fleet_leases.#{key}", "forged")
    end

    assert ask(client, "hub.kv.put.fleet_plans.hash", "forged") == @nobody
    assert ask(client, "hub.kv.get.fleet_reported.test.B") == @nobody
    assert {:ok, _stored} = ask(client, "hub.kv.put.fleet_leases.test.vehicles.A", "gateway-A")
    flush(client)
    {:ok, leases} = answered(fleet, fn -> KV.contents(fleet, "fleet_leases") end)

    assert leases == %{
             "test.gateways.f00d" => "true",
             "test.vehicles.B" => "true",
             "test.vehicles.A" => "gateway-A"
           }
  end

  test "commands and desired states of its own are asked at the hub; another one's it cannot answer",
       context do
    %{fleet: fleet, client: client} = context
    answering(client, "fleet.test.B.cmd.*", "not mine")
    answering(client, "fleet.test.*.shadow.*", "not mine")
    answering(client, "fleet.test.A.cmd.*", "mine")
    eventually(fn -> match?({:ok, %{body: "mine"}}, try_to_ask(fleet, "fleet.test.A.cmd.arm")) end)
    for _ <- 1..20, do: assert(try_to_ask(fleet, "fleet.test.B.cmd.arm") in [@nobody, {:error, :timeout}])
    assert ask(fleet, "fleet.test.A.shadow.get") == @nobody
    # As a gateway it may not ask others either.
    assert ask(client, "fleet.test.B.mission.get") == @nobody
  end

  test "it cannot read another one's commands, desired state or events", context do
    %{hub: hub, fleet: fleet, client: client} = context
    b = start_bridge(HubServer.leaf(hub, "B"))
    HubServer.await_hub(b)
    client_b = HubServer.local_client(await_up(b))
    answering(client, "fleet.test.B.>", "mine")
    answering(client, "hub.kv.new.>", "mine")
    answering(client_b, "fleet.test.B.cmd.*", "of B")
    :ok = answered(fleet, fn -> KV.put_value(fleet, "fleet_desired", "test.B", "secret") end)
    eventually(fn -> match?({:ok, %{body: "of B"}}, try_to_ask(fleet, "fleet.test.B.cmd.arm")) end)
    for _ <- 1..20, do: assert({:ok, %{body: "of B"}} = ask(fleet, "fleet.test.B.cmd.arm"))

    {:ok, _} = Gnat.sub(client, self(), "stolen.*")

    for subject <- [
          "hub.kv.get.fleet_desired.test.B",
          "$JS.hub.API.STREAM.MSG.GET.KV_fleet_desired",
          "$JS.hub.API.CONSUMER.CREATE.FLEET_EVENTS_B",
          "$JS.hub.API.STREAM.NAMES"
        ],
        do:
          :ok =
            Gnat.pub(client, subject, ~s({"last_by_subj":"$KV.fleet_desired.test.B"}), reply_to: "stolen.it")

    flush(client)
    # Its account has no JetStream, which can only say that it does not understand.
    assert Enum.all?(stolen(), &(&1[:status] == "503" or &1.body =~ ~s("error")))
    commit(b, "B", 1..2)
    eventually(fn -> length(for {"B", _, _} <- events(fleet), do: 1) == 2 end)
    # What is its own arrives, so what is not would have.
    :ok = answered(fleet, fn -> KV.put_value(fleet, "fleet_desired", "test.A", "own") end)
    assert_receive {:seen, "hub.kv.new.fleet_desired.test.A"}
    refute Enum.any?(seen(), &(&1 =~ "test.B.event" or &1 == "hub.kv.new.fleet_desired.test.B"))
  end

  defp stolen do
    receive do
      {:msg, %{topic: "stolen" <> _} = message} -> [message | stolen()]
    after
      0 -> []
    end
  end

  defp seen do
    receive do
      {:seen, topic} -> [topic | seen()]
    after
      0 -> []
    end
  end

  test "its key opens a leaf node and nothing else, and no longer that once it is revoked", context do
    %{hub: hub, a: a, tmp_dir: dir} = context
    file = Path.join(hub.set, "vehicles/A/leaf.nk")
    seed = File.read!(file)
    # Our clients end with their servers.
    Process.flag(:trap_exit, true)
    assert {:error, error} = log_in(HubServer.login(hub, seed))
    assert Aerie.Fleet.Nats.text(error) =~ if(own_client?(), do: ~r/authorization/i, else: ~r/lost|closed/)

    HubServer.revoke(hub, ["A"])
    # It has gone from the set; a vehicle has its own copy.
    refute File.exists?(file)
    :ok = Aerie.Base.Files.Private.write(file, seed)
    # The open connection leads nowhere any more, and a new one is refused.
    await(a, :hub, &(&1[:status] == :down and &1[:problem] == "it does not answer"))
    {:ok, _} = Gnat.sub(context.fleet, self(), "fleet.test.A.>")
    :ok = Gnat.pub(context.client, "fleet.test.A.state.mode", "forged")
    kill9(server_pid(Path.join(dir, "A")))
    await(a, :hub, &((&1[:problem] || "") =~ ~r/authoriz/i))
    refute_received {:msg, _message}
    # The vehicle's own NATS works on.
    commit(a, "A", 1..2)
    await_empty(a)
    eventually(fn -> Bridge.info(a).problem == nil end)
  end
end
