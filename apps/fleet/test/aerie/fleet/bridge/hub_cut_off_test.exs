defmodule Aerie.Fleet.Bridge.HubCutOffTest do
  @moduledoc """
  The hub ends a connection: of somebody who reads too slowly, or whose key is revoked. Real servers; every event is in the hub's stream
  once and in its order.
  """
  use Aerie.BridgeCase, async: true

  import Aerie.HubCase

  alias Aerie.HubServer
  alias Gnat.Jetstream.API.Stream

  @moduletag :tmp_dir
  @moduletag :capture_log

  test "a reader that does not read keeps nobody waiting, and the hub's server ends its connection", %{
    tmp_dir: dir
  } do
    Process.flag(:trap_exit, true)
    %{hub: hub, leaves: leaves} = start(dir, 1)
    slow = conn(hub)
    {:ok, _} = Gnat.sub(slow, self(), "fleet.>")
    :sys.suspend(slow, Aerie.Patience.ms())
    client = conn(hub)
    flood(client)
    make(leaves, 1..200)
    await_all(client, leaves, 200)
    await_log(hub, "Slow Consumer")
    :sys.resume(slow, Aerie.Patience.ms())
    assert_receive {:EXIT, ^slow, _closed}
    make(leaves, 201..210)
    await_all(client, leaves, 210)
  end

  # The namesake's socket goes on into the mailbox of a client that stands still, so that its server sees nothing slow.
  @tag skip: not own_client?() && "only the client in packages/ stops reading with its process"
  test "the hub's gateway reads too slowly: it is cut off, comes back, and its events are there once", %{
    tmp_dir: dir
  } do
    Process.flag(:trap_exit, true)
    %{hub: hub, fleet: fleet, leaves: leaves} = start(dir, 1)
    client = conn(hub)
    commit(fleet, "G", 1..10)
    # The gateway makes a vehicle's stream with its first event.
    make(leaves, 1..1)
    await_stored(client, 11)
    slow = Bridge.connection(fleet)
    {:ok, _} = Gnat.sub(slow, self(), "fleet.test.*.raw.in")
    :sys.suspend(slow, Aerie.Patience.ms())
    # What it publishes goes nowhere now, and what the others do goes on.
    commit(fleet, "G", 11..60)
    flood(client)
    make(leaves, 2..100)
    await_stored(client, 110)
    await_log(hub, "Slow Consumer")
    :sys.resume(slow, Aerie.Patience.ms())
    await_reconnected(fleet, slow)
    commit(fleet, "G", 61..70)
    await_stored(client, 170)
    assert %{"G" => own, "V1" => rows} = arrived(client, ["G", "V1"])
    assert Enum.map(own, &elem(&1, 0)) == Enum.to_list(1..70)
    assert Enum.map(rows, &elem(&1, 0)) == Enum.to_list(1..100)
    assert metric(fleet, "gateway_nats_disconnects_total") >= 1
    eventually(fn -> Bridge.info(fleet).problem == nil end)
  end

  test "a leaf's server stands still while the hub has much for it: it comes back, and its events are there once",
       %{
         tmp_dir: dir
       } do
    Process.flag(:trap_exit, true)
    %{hub: hub, leaves: [{"V1", leaf}, {"V2", _other}] = leaves} = start(dir, 2)
    aboard = HubServer.local_client(await_up(leaf))
    {:ok, _} = Gnat.sub(aboard, self(), "hub.kv.new.>")
    client = conn(hub)
    # The hub knows of the subscription.
    eventually(fn ->
      :ok = Gnat.pub(client, "$KV.fleet_desired.test.V1", "first")
      receive do: ({:msg, %{body: "first"}} -> true), after: (100 -> nil)
    end)

    make(leaves, 1..10)
    await_all(client, leaves, 10)
    pid = server_pid(Path.join(dir, "V1"))
    {_, 0} = System.cmd("kill", ["-STOP", pid])
    flood(client, "$KV.fleet_desired.test.V1")
    make(leaves, 11..60)
    # By the hub, or by its own gateway, which restarts a server that confirms nothing.
    await_log(hub, ~r/Slow Consumer|Leafnode connection closed/)
    _gone = System.cmd("kill", ["-CONT", pid], stderr_to_stdout: true)
    await_all(client, leaves, 60)
    await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0))
    make(leaves, 61..70)
    await_all(client, leaves, 70)
  end

  test "the key of the hub's gateway is revoked: it says so, its events wait, and a new key is enough", %{
    tmp_dir: dir
  } do
    Process.flag(:trap_exit, true)
    hub = HubServer.start(dir, ["V1"])
    own = Path.join(dir, "own.nk")
    File.cp!(Path.join(hub.set, "hub/gateway.nk"), own)
    %{fleet: fleet, leaves: leaves} = connect(hub, ["V1"], settings: [{"nats.nkey_seed_file", own}])
    client = conn(hub)
    commit(fleet, "G", 1..10)
    make(leaves, 1..10)
    await_stored(client, 20)
    HubServer.change(hub, %{new_keys: ["hub"]})
    HubServer.signal(hub, "HUP")
    # The namesake of the client has the server's reason in its log only.
    {words, mend_words} =
      if own_client?(), do: {~r/authoriz/i, "read again at each attempt"}, else: {~r/lost|closed/, ""}

    refused = &(&1[:status] == :down and to_string(&1[:problem]) =~ words)
    await(fleet, :connection, refused)
    # A client with the old key is cut off as well.
    assert_receive {:EXIT, ^client, _refused}
    # An attempt may have had no answer in time since.
    eventually(fn -> to_string(Bridge.info(fleet).problem) =~ ~r/tls:.*(#{Regex.source(words)})/i end)

    eventually(fn ->
      with [%{evidence: [why | _], mend: mend}] <- told(fleet, :nats_unreachable),
           do: why =~ words and mend =~ mend_words,
           else: (_none -> false)
    end)

    # The vehicles' keys are others.
    commit(fleet, "G", 11..60)
    make(leaves, 11..60)
    await(fleet, :outbox, &(&1[:events] == 50))
    client = conn(hub)
    await_stored(client, 70)
    await(fleet, :connection, refused)
    File.cp!(Path.join(hub.set, "hub/gateway.nk"), own)
    await_up(fleet)
    commit(fleet, "G", 61..70)
    await_stored(client, 130)
    assert %{"G" => rows, "V1" => others} = arrived(client, ["G", "V1"])
    assert Enum.map(rows, &elem(&1, 0)) == Enum.to_list(1..70)
    assert for({seq, true} <- rows, do: seq) -- Enum.to_list(11..70) == []
    assert Enum.map(others, &elem(&1, 0)) == Enum.to_list(1..60)
    eventually(fn -> told(fleet, :nats_unreachable) == [] end)
    eventually(fn -> Bridge.info(fleet).problem == nil end)
  end

  test "a vehicle's key is revoked and it gets another one, and a vehicle is added: events wait, and arrive once",
       %{
         tmp_dir: dir
       } do
    Process.flag(:trap_exit, true)
    hub = HubServer.start(dir, names(2))
    %{leaves: [{"V2", _} = other]} = connect(hub, ["V2"], [])
    copied = Path.join(hub.set, "vehicles/V1/leaf.nk")
    own = Path.join(dir, "own.nk")
    File.cp!(copied, own)
    settings = HubServer.leaf(hub, "V1", [{"nats.leaf.nkey_seed_file", own}])
    leaf = start_bridge(settings, epoch: 1)
    HubServer.await_hub(leaf)
    leaves = [{"V1", leaf}, other]
    make(leaves, 1..10)
    await_all(conn(hub), leaves, 10)
    HubServer.change(hub, %{new_keys: ["V1"], vehicles: ["V3"]})
    HubServer.kill(hub)
    HubServer.restart(hub)
    await(leaf, :hub, &(&1[:status] == :down and to_string(&1[:problem]) =~ ~r/authoriz/i))
    make(leaves, 11..60)
    await_aboard(leaves)
    # The other vehicle's key is as good as before.
    client = conn(hub)
    await_stored(client, 70)
    await(leaf, :hub, &(&1[:status] == :down and &1[:waiting] >= 50))
    # The reason stays known while the server tries again and again.
    forget_news()
    tried = refusals(hub)
    eventually(fn -> refusals(hub) >= tried + 3 end)
    for info <- news(leaf, :hub), do: assert(info.problem =~ ~r/authoriz/i)
    assert [%{evidence: [why | _], mend: mend}] = told(leaf, :hub_unreachable)
    assert why =~ ~r/authoriz/i and mend =~ "a new key is taken when the gateway starts again"
    File.cp!(copied, own)
    stop_bridge(leaf)
    start_bridge_again(leaf, settings)
    HubServer.await_hub(leaf)
    added = start_bridge(HubServer.leaf(hub, "V3"), epoch: 1)
    HubServer.await_hub(added)
    commit(added, "V3", 1..60)
    make(leaves, 61..70)
    await_stored(client, 200)

    assert for({id, rows} <- arrived(client, names(3)), do: {id, Enum.map(rows, &elem(&1, 0))}) ==
             [{"V1", Enum.to_list(1..70)}, {"V2", Enum.to_list(1..70)}, {"V3", Enum.to_list(1..60)}]
  end

  @tag :long
  test "a vehicle is added to a hub of three servers, which are restarted one after the other", %{
    tmp_dir: dir
  } do
    Process.flag(:trap_exit, true)
    %{hub: hub, leaves: leaves} = start(dir, 2, servers: 3)
    make(leaves, 1..10)
    await_all(conn(hub), leaves, 10)
    HubServer.change(hub, %{vehicles: ["V3"]})

    for {host, n} <- Enum.zip(hub.hosts, 2..4) do
      HubServer.kill(hub, host)
      make(leaves, (n * 10 - 9)..(n * 10))
      HubServer.restart(hub, host)
      # Before the next one is stopped, the stream has its three copies again.
      for {_id, leaf} <- leaves, do: await(leaf, :hub, &(&1[:status] == :up and &1[:waiting] == 0))
      eventually(fn -> in_step?(conn(hub, host)) end)
    end

    client = conn(hub)
    await_all(client, leaves, 40)
    added = start_bridge(HubServer.leaf(hub, "V3"), epoch: 1)
    HubServer.await_hub(added)
    leaves = [{"V3", added} | leaves]
    commit(added, "V3", 1..40)
    make(leaves, 41..50)
    await_all(client, leaves, 50)
  end

  defp in_step?(conn) do
    with {:ok, %{streams: streams}} <- Aerie.Fleet.Nats.call(conn, fn -> Stream.list(conn) end) do
      Enum.all?(streams, fn name ->
        case Aerie.Fleet.Nats.call(conn, fn -> Stream.info(conn, name) end) do
          {:ok, %{cluster: %{"leader" => _, "replicas" => copies}}} -> Enum.all?(copies, & &1["current"])
          _not_now -> false
        end
      end)
    else
      {:error, _not_now} -> false
    end
  end

  # More than what systems on the way hold for a reader.
  defp flood(client, subject \\ "fleet.test.V2.raw.in") do
    much = String.duplicate("x", 100_000)
    for _ <- 1..600, do: :ok = Gnat.pub(client, subject, much)
  end

  defp refusals(hub),
    do:
      HubServer.folder(hub)
      |> Path.join("log")
      |> File.read!()
      |> String.split("authentication error")
      |> length()

  defp news(gateway, part) do
    receive do
      {:news, ^gateway, ^part, info} -> [info | news(gateway, part)]
    after
      0 -> []
    end
  end

  defp await_log(hub, text) do
    log = Path.join(HubServer.folder(hub), "log")
    eventually(fn -> File.read!(log) =~ text end)
  end
end
