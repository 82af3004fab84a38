defmodule Aerie.Fleet.Shadow.Documents.UplinkTest do
  @moduledoc """
  Desired and reported state between a hub and a companion that is its leaf node: real servers, cut and together again.
  """
  use Aerie.ShadowCase, async: true

  alias Aerie.Control.Policy
  alias Aerie.HubServer
  alias Aerie.Fleet.Shadow.Loop.Plans

  @moduletag :tmp_dir
  @moduletag :capture_log
  @id "A"
  @ops %{name: "ops", role: :admin, permissions: []}
  @common "the key of the whole fleet"
  @key {"shadow.key", @common}

  setup %{tmp_dir: dir} = context do
    Process.flag(:trap_exit, true)
    server = HubServer.start(dir, [@id])
    hub = start_bridge(HubServer.gateway(server))
    await_up(hub)
    url = [{"nats.mode", "url"}, {"nats.url", "nats://unused"}, {"shadow.lease_s", 1}]
    start_shadow(hub, Path.join(dir, "hub"), [@key | url])
    leaf = start_bridge(HubServer.leaf(server, @id))
    HubServer.await_hub(leaf)
    put_policy(leaf, server, Map.get(context, :role, :admin))
    start_aboard(leaf, server, context[:key] || own_key())
    %{server: server, hub: hub, leaf: leaf}
  end

  # What the hub may do aboard: by the key that bin/nats-setup made for it, unless the test has no such source.
  defp put_policy(leaf, server, role) do
    %{"gateway" => nkey} = server.set |> Path.join("fleet.json") |> File.read!() |> JSON.decode!()
    sources = if role, do: [%{name: "hub", nkey: nkey, role: role}], else: []
    {:ok, policy} = Policy.compile(%{sources: sources})
    start_supervised!({Policy.Store, gateway: leaf, policy: policy})
  end

  # The hub has the common key, a vehicle its own.
  defp own_key, do: {"shadow.vehicle_key", Shadow.Keys.derive(@common, "test", @id)}

  defp start_aboard(leaf, server, key) do
    own = Path.join([server.set, "vehicles", @id])

    start_shadow(leaf, Path.join(server.dir, "aboard"), [
      key,
      {"nats.mode", "embedded"},
      {"vehicle_id", @id},
      {"shadow.lease_s", 1},
      {"nats.leaf.url", "tls://127.0.0.1:#{server.ports.leaf}"},
      {"nats.leaf.nkey_seed_file", Path.join(own, "leaf.nk")}
    ])
  end

  # Until the buckets are there.
  defp desire(gateway, desired) do
    eventually(fn ->
      with {:error, {:unavailable, _why}} <-
             Shadow.update(gateway, @id, %{"desired" => desired}, @ops, "rest"),
           do: false
    end)
  end

  defp desired(gateway) do
    case Shadow.get(gateway, @id) do
      {:ok, %{"desired" => desired, "version" => version}} -> {desired, version}
      {:error, why} -> why
    end
  end

  defp await_both(%{hub: hub, leaf: leaf}, fun) do
    eventually(fn ->
      match?({_desired, _version}, desired(hub)) and desired(hub) == desired(leaf) and fun.(desired(hub))
    end)
  end

  test "what is desired at the hub is desired aboard, and the other way; what is reported goes up", context do
    %{hub: hub, leaf: leaf} = context
    assert {:ok, %{"version" => 1}} = desire(hub, %{"mode" => "LOITER"})
    await_both(context, &match?({%{"mode" => "LOITER"}, 1}, &1))
    assert {:ok, %{"version" => 2}} = desire(leaf, %{"tags" => ["north"]})
    await_both(context, &match?({%{"mode" => "LOITER", "tags" => ["north"]}, 2}, &1))
    eventually(fn -> Shadow.tags(hub) == %{@id => ["north"]} end)

    Documents.join(documents(leaf), @id)
    Documents.report(documents(leaf), @id, %{}, %{"mode" => "GUIDED"})
    eventually(fn -> match?({:ok, %{"reported" => %{"mode" => "GUIDED"}}}, Shadow.get(hub, @id)) end)
    assert Documents.problem(leaf) == nil

    plan = Protocols.Mission.File.QgcPlan.write(%Protocols.Mission.Plan{})
    {:ok, hash} = Shadow.put_plan(hub, plan)
    assert {:ok, %Protocols.Mission.Plan{}} = Plans.fetch(leaf, hash)
  end

  test "a cut: what was written on either side arrives afterwards; of a field that both changed the hub's counts",
       context do
    %{server: server, hub: hub, leaf: leaf} = context
    desire(hub, %{"mode" => "LOITER", "tags" => ["before"]})
    await_both(context, &match?({_desired, 1}, &1))
    # What both have is written down a moment after both have it.
    common = Path.join(server.dir, "aboard/shadow/hub/desired/*")
    eventually(fn -> Path.wildcard(common) != [] end)

    HubServer.kill(server)
    await(leaf, :hub, &(&1[:status] == :down))
    assert {:ok, %{"version" => 2}} = desire(leaf, %{"mode" => "RTL", "params" => %{"A" => 1}})
    assert {:ok, %{"version" => 3}} = desire(leaf, %{"tags" => nil})
    # A restart of the gateway aboard does not forget what both had.
    stop_supervised!({:shadow, leaf})
    start_aboard(leaf, server, own_key())
    # The leaf stays away while the hub is back.
    pid = server_pid(Path.join(server.dir, @id))
    {_text, 0} = System.cmd("kill", ["-STOP", pid])
    HubServer.restart(server)
    assert {:ok, %{"version" => 2}} = desire(hub, %{"mode" => "LAND", "params" => %{"B" => 2}})
    {_text, 0} = System.cmd("kill", ["-CONT", pid])

    begun = System.monotonic_time(:millisecond)
    await_both(context, &match?({%{"mode" => "LAND", "params" => %{"A" => 1.0, "B" => 2.0}}, 4}, &1))
    assert System.monotonic_time(:millisecond) >= begun
    {both, 4} = desired(hub)
    refute is_map_key(both, "tags")
    {:ok, %{"history" => [%{"actor" => "shadow", "set" => ["mode"]} | _before]}} = Shadow.get(leaf, @id)
  end

  test "the gateway aboard acts on its vehicle, also if the hub did before, and nobody takes it over",
       context do
    %{server: server, hub: hub, leaf: leaf} = context
    for gateway <- [hub, leaf], do: Documents.join(documents(gateway), @id)
    Documents.vehicle_heard(documents(hub), @id, true)
    eventually(fn -> Documents.authority(hub, @id) == :mine end)
    Documents.vehicle_heard(documents(leaf), @id, true)
    eventually(fn -> Documents.authority(leaf, @id) == :mine end)

    eventually(fn ->
      Documents.authority(hub, @id) == {:held, "gateway", "the gateway gateway-A acts on it"}
    end)

    # Three times as long as others wait.
    kill9(server_pid(Path.join(server.dir, @id)))
    stop_bridge(leaf)
    renewed = fn -> :sys.get_state(documents(hub), Aerie.Patience.ms()).lease.renewed_at end
    from = renewed.()
    eventually(fn -> renewed.() > from + 4_500 end)
    assert {:held, "gateway", _why} = Documents.authority(hub, @id)
    assert Aerie.Fleet.Shadow.Documents.problem(hub) == nil
  end

  test "when the gateway aboard hears its vehicle no more, the hub takes it at once", context do
    %{hub: hub, leaf: leaf} = context
    for gateway <- [hub, leaf], do: Documents.join(documents(gateway), @id)
    Documents.vehicle_heard(documents(leaf), @id, true)
    Documents.vehicle_heard(documents(hub), @id, true)

    eventually(fn ->
      match?({:held, "gateway", "the gateway gateway-A" <> _}, Documents.authority(hub, @id))
    end)

    Documents.vehicle_heard(documents(leaf), @id, false)
    eventually(fn -> Documents.authority(hub, @id) == :mine end)
  end

  @tag role: :operator
  test "what the hub may not do aboard it may not desire there: it is taken back, and told", context do
    %{hub: hub, leaf: leaf} = context
    assert {:ok, _document} = desire(leaf, %{"params" => %{"KEPT" => 1}})
    await_both(context, &match?({%{"params" => %{"KEPT" => 1.0}}, _version}, &1))

    # An admin at the hub, which is an operator aboard.
    assert {:ok, _document} = desire(hub, %{"mode" => "LOITER", "params" => %{"RTL_ALT" => 5000}})

    await_both(
      context,
      &match?({%{"mode" => "LOITER", "params" => params}, _version} when params == %{"KEPT" => 1.0}, &1)
    )

    assert {:ok, %{"history" => history}} = Shadow.get(hub, @id)

    assert %{"reason" => "refused aboard" <> _, "removed" => ["params.RTL_ALT"]} =
             Enum.find(history, &(&1["actor"] == "shadow"))

    # Counted once both have the document.
    eventually(fn -> Store.counter(leaf, {:shadow, :updates_refused}) >= 1 end)

    # Nor may it take away what somebody aboard desires.
    assert {:ok, _document} = desire(hub, %{"params" => %{"KEPT" => nil}})
    await_both(context, &match?({%{"params" => %{"KEPT" => 1.0}}, version} when version > 4, &1))
    # The gateway aboard goes on asking its own policy only.
    assert {:ok, _document} = desire(leaf, %{"params" => %{"RTL_ALT" => 3000}})
    await_both(context, &match?({%{"params" => %{"RTL_ALT" => 3000.0}}, _version}, &1))
  end

  @tag role: nil
  test "with nobody who is the hub, it desires in vain", context do
    %{hub: hub, leaf: leaf} = context
    assert {:ok, _document} = desire(hub, %{"mode" => "LOITER", "tags" => ["north"]})
    await_both(context, &match?({desired, version} when desired == %{} and version > 1, &1))
    assert {:ok, _document} = desire(leaf, %{"tags" => ["south"]})
    await_both(context, &match?({%{"tags" => ["south"]}, _version}, &1))
  end

  @tag key: {"shadow.key", "another key than the hub's"}
  test "with another key than the hub's nothing is passed on, and the report says so", %{hub: hub, leaf: leaf} do
    desire(hub, %{"mode" => "LOITER"})

    eventually(fn ->
      (Documents.problem(leaf) || "") =~ "the hub's desired state of A is not heeded: its seal"
    end)

    assert {%{}, 0} = desired(leaf)
    assert {_desired, 1} = desired(hub)
  end
end
