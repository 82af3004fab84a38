defmodule Aerie.Vehicle.Services.IdentityTest do
  @moduledoc "The gateway's own heartbeat over a real UDP link, while its loops are suspended and come back."
  use Aerie.VehicleCase, async: true

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.{Options, Settings}
  alias MavCodec.{Frame, Parser}

  @loopback {127, 0, 0, 1}
  @deadman_s 0.6

  # A gateway with one vehicle on one UDP link, kept alive by the test; `vehicle` is the socket that plays it.
  defp flying(config \\ %{}) do
    mavlink = Map.merge(%{heartbeat_deadman_s: @deadman_s, request_streams: false}, config)
    config = %{mavlink: Map.merge(%{system_id: 245, component_id: 191}, mavlink)}
    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0")
    {gateway, port, vehicle(port, 1)}
  end

  defp vehicle(port, system) do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: false])
    :ok = :gen_udp.send(socket, @loopback, port, heartbeat(system))
    socket
  end

  # The next heartbeat of the gateway that comes to a vehicle's socket within `ms`, or nil.
  defp heard(socket, ms \\ Aerie.Patience.ms()) do
    case :gen_udp.recv(socket, 0, ms) do
      {:ok, {_from, _port, bytes}} ->
        {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, nil)
        Enum.find(frames, &(&1.id == 0 and &1.system == 245)) || heard(socket, ms)

      {:error, :timeout} ->
        nil
    end
  end

  # A heartbeat says that all is well; on a busy machine some loop may be silent for a moment.
  defp active(socket),
    do: eventually(fn -> match?({:ok, %{system_status: 4}}, MavCodec.decode(heard(socket))) end)

  # None comes for so long. One may still be on its way when it is found that there are to be no more.
  defp unheard(socket, ms) do
    drain(socket)
    eventually(fn -> heard(socket, ms) == nil end)
  end

  # Everything that waits in the socket is passed over.
  defp drain(socket) do
    case :gen_udp.recv(socket, 0, 0) do
      {:ok, _datagram} -> drain(socket)
      {:error, :timeout} -> :ok
    end
  end

  defp silent?(gateway, tag), do: eventually(fn -> tag in MavRouter.Identity.status(gateway).silent end)

  test "H1, H2, R10: an on-board computer's heartbeat under our own ids, again and again" do
    {_gateway, _port, socket} = flying()
    assert %Frame{system: 245, component: 191} = frame = heard(socket)
    assert {:ok, %{type: 18, autopilot: 8}} = MavCodec.decode(frame)
    active(socket)
  end

  for {role, id} <- [
        store: nil,
        pubsub: nil,
        router_sweeper: nil,
        watchdog: nil,
        session: {"main", 1},
        events: {"main", 1}
      ] do
    @tag loop: {role, id}
    test "H3: no heartbeat while #{role} stands still, and again when it turns", %{loop: {role, id} = tag} do
      {gateway, _port, socket} = flying()
      assert heard(socket)
      pid = Names.whereis(gateway, role, id)
      :ok = :sys.suspend(pid, Aerie.Patience.ms())
      silent?(gateway, tag)
      unheard(socket, 1_300)
      :ok = :sys.resume(pid, Aerie.Patience.ms())
      assert heard(socket)
      eventually(fn -> MavRouter.Identity.status(gateway).silent == [] end)
    end
  end

  for role <- [:store, :router_sweeper, :watchdog] do
    test "H3: nor does one that calls and hears nothing get any while #{role} stands still" do
      mavlink = %{heartbeat_deadman_s: @deadman_s, system_id: 245, component_id: 191}
      gateway = Aerie.GatewayCase.start_gateway(%{mavlink: mavlink}, with: [:router, :links])
      {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: false])
      {:ok, port} = :inet.port(socket)
      add_link(gateway, "udpout:127.0.0.1:#{port}")
      assert %Frame{component: 191} = heard(socket)
      pid = Names.whereis(gateway, unquote(role))
      :ok = :sys.suspend(pid, Aerie.Patience.ms())
      silent?(gateway, {unquote(role), nil})
      unheard(socket, 2_500)
      eventually(fn -> Store.counter(gateway, {:identity, :held}) > 0 end)
      :ok = :sys.resume(pid, Aerie.Patience.ms())
      active(socket)
    end
  end

  test "X6: a link that is configured as one of high latency gets nothing, until the command asks for it" do
    mavlink = %{heartbeat_deadman_s: @deadman_s, system_id: 245, component_id: 191}
    gateway = start_parts(%{mavlink: mavlink})
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", options: [high_latency: true])
    socket = vehicle(port, 1)
    eventually(fn -> match?(%{high_latency: %{only?: true}}, Store.vehicle(gateway, {"main", 1})) end)
    :ok = Vehicle.Services.Links.HighLatency.request(gateway, {"main", 1}, true)
    # It is the first thing that comes.
    assert {:ok, {_from, _port, bytes}} = :gen_udp.recv(socket, 0, Aerie.Patience.ms())
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, nil)
    assert {:ok, %{command: 2600, param1: 1.0}} = MavCodec.decode(frame)
    assert {:error, :timeout} = :gen_udp.recv(socket, 0, 1_300)
  end

  test "a killed loop is asked again" do
    {gateway, _port, socket} = flying()
    assert heard(socket)
    Process.exit(Names.whereis(gateway, :watchdog), :kill)
    Process.exit(Names.whereis(gateway, :router_sweeper), :kill)
    drain(socket)
    assert heard(socket)
  end

  test "another vehicle's stuck loop does not cost this one its heartbeat, which says critical" do
    {gateway, port, one} = flying()
    two = vehicle(port, 2)
    assert heard(one) && heard(two)
    :ok = :sys.suspend(Names.whereis(gateway, :session, {"main", 2}), Aerie.Patience.ms())
    silent?(gateway, {:session, {"main", 2}})
    drain(one)
    eventually(fn -> match?({:ok, %{system_status: 5}}, MavCodec.decode(heard(one))) end)
    unheard(two, 1_300)

    # Of all other loops each may be silent for a moment on a busy machine.
    eventually(fn ->
      match?(%{alive: true, silent: [{:session, {"main", 2}}]}, MavRouter.Identity.status(gateway))
    end)
  end

  test "what is held back is counted" do
    {gateway, _port, socket} = flying()
    assert heard(socket)
    :ok = :sys.suspend(Names.whereis(gateway, :store), Aerie.Patience.ms())
    eventually(fn -> Store.counter(gateway, {:identity, :held}) > 0 end)
  end

  test "a vehicle that is removed is asked no more" do
    {gateway, _port, socket} = flying()
    assert heard(socket)
    :ok = :sys.suspend(Names.whereis(gateway, :events, {"main", 1}), Aerie.Patience.ms())
    silent?(gateway, {:events, {"main", 1}})
    :sys.resume(Names.whereis(gateway, :events, {"main", 1}), Aerie.Patience.ms())
    :ok = Vehicle.Supervisor.remove(gateway, {"main", 1})
    eventually(fn -> MavRouter.Identity.status(gateway).silent == [] end)
  end

  # Sends the test the role of each process that is said to be silent.
  defp complaints(gateway) do
    test = self()

    told = fn _event, _count, told, _config ->
      if told.gateway == gateway, do: send(test, {:silent, told.role, System.monotonic_time(:millisecond)})
    end

    :ok = :telemetry.attach(gateway, [:aerie, :identity, :silent], told, nil)
    on_exit(fn -> :telemetry.detach(gateway) end)
  end

  test "a machine that stood still is not a silence of its loops, which nobody asked" do
    {gateway, _port, _socket} = flying(%{heartbeat_deadman_s: 60})
    complaints(gateway)
    tag = {:session, {"main", 1}}

    :ok =
      eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end) |> :sys.suspend(Aerie.Patience.ms())

    watchdog = Names.whereis(gateway, :watchdog)
    # All have answered but for one, which owes an answer as well.
    eventually(fn -> :sys.get_state(watchdog, Aerie.Patience.ms()).owing |> Map.keys() == [tag] end)

    # All of it two minutes ago.
    :sys.replace_state(
      watchdog,
      fn %{table: table} = state ->
        for {tag, at, answered?} <- :ets.tab2list(table),
            do: :ets.insert(table, {tag, at - 120_000, answered?})

        {:noreply, state} =
          MavRouter.Identity.Watchdog.handle_info(:ask, %{state | asked: state.asked - 120_000})

        state
      end,
      Aerie.Patience.ms()
    )

    refute_received {:silent, _role, _at}
    assert MavRouter.Identity.status(gateway).silent == []
  end

  test "a gateway that starts is given its time before anyone complains" do
    gateway = make_ref()
    complaints(gateway)
    # Deaf to everything: none of the processes that it asks for is there.
    options = [gateway: gateway, settings: %MavRouter.Identity.Settings{deadman_ms: 2_000}]
    begun = System.monotonic_time(:millisecond)
    watchdog = start_supervised!({MavRouter.Identity.Watchdog, options})
    _asked = :sys.get_state(watchdog, Aerie.Patience.ms())
    refute MavRouter.Identity.status(gateway).alive
    # The roles are told of in one go, so this time is that of the first one.
    assert_receive {:silent, :store, at}
    assert at - begun >= 2_000
  end

  test "without a gateway nothing is alive" do
    assert %{alive: false, silent: [{:watchdog, nil}]} = MavRouter.Identity.status(make_ref())
  end

  describe "who we are" do
    test "a companion is component 191 of its vehicle, a hub system 237" do
      companion =
        Options.new(Settings.from(%{vehicle_id: "A", mavlink: %{system_id: 7}}), {"main", 7})

      assert {companion.own_system, companion.own_component} == {7, 191}
      hub = Options.new(Settings.from(%{}), {"main", 7})
      assert {hub.own_system, hub.own_component} == {237, 191}
    end

    test "H5: only a gateway that is meant to be the ground station says so" do
      {_gateway, _port, socket} = flying(%{i_am_the_gcs: true})
      assert {:ok, %{type: 6, autopilot: 8}} = MavCodec.decode(heard(socket))
    end
  end
end
