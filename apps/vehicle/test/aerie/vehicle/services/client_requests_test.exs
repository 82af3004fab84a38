defmodule Aerie.Vehicle.Services.ClientRequestsTest do
  @moduledoc "Clients' requests for rates on their way to a vehicle, and what a link of high latency carries."
  use Aerie.VehicleCase, async: true

  alias Aerie.Vehicle.Services.StreamDemand
  alias Aerie.Base.Store
  alias MavRouter.Client.LocalEndpoint
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  @loopback {127, 0, 0, 1}
  @key {"main", 1}

  # A gateway that says little itself, and a vehicle on a link of it.
  defp flying(options \\ [], first \\ heartbeat(1), more \\ %{}) do
    mavlink = %{
      system_id: 245,
      component_id: 191,
      heartbeat: false,
      timesync_s: 0,
      read_gcs_parameters: false
    }

    config = %{mavlink: Map.merge(mavlink, more)}
    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", options)
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: false])
    :ok = :gen_udp.send(socket, @loopback, port, first)
    eventually(fn -> Store.vehicle(gateway, @key) end)
    {gateway, socket}
  end

  defp client(gateway, id) do
    {:ok, endpoint} = LocalEndpoint.attach(gateway, id: id, text: id, side: :client)
    endpoint
  end

  defp says(endpoint, message) do
    bytes = MavCodec.encode(message, system: 255, component: 190)
    {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, System.os_time(:microsecond))
    LocalEndpoint.ingress(endpoint, frames)
    bytes
  end

  # What comes next to the vehicle from a client.
  defp heard(socket) do
    {:ok, {_from, _port, bytes}} = :gen_udp.recv(socket, 0, Aerie.Patience.ms())
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, nil)
    if frame.system == 255, do: bytes, else: heard(socket)
  end

  defp set(id, hz),
    do: %M.CommandLong{
      target_system: 1,
      target_component: 1,
      command: 511,
      param1: id * 1.0,
      param2: 1.0e6 / hz
    }

  test "M2: the first request is forwarded, one for less is answered; when the first client goes, its want goes" do
    {gateway, vehicle} = flying()
    one = client(gateway, "one")
    bytes = says(one, set(30, 10))
    assert heard(vehicle) == bytes
    assert [{{:endpoint, {"one", :self}}, 30, 10.0}] = StreamDemand.list(gateway, @key)

    # Another process, for an endpoint belongs to its process.
    test = self()

    spawn_link(fn ->
      two = client(gateway, "two")
      says(two, set(30, 2))
      receive do: ({:forward, [answer], class} -> send(test, {:answer, answer, class}))
      receive do: (:stop -> :ok)
    end)

    assert_receive {:answer, answer, :ack}
    assert {[%Frame{system: 1, component: 1} = ack], _} = Parser.push_datagram(Parser.new(), answer, nil)
    assert {:ok, %M.CommandAck{command: 511, result: 0, target_system: 255}} = MavCodec.decode(ack)
    # What comes to the vehicle next is something else.
    bytes = says(one, %M.ParamRequestList{target_system: 1, target_component: 1})
    assert heard(vehicle) == bytes
    assert %{messages: %{30 => 10.0}} = StreamDemand.merged(gateway, @key)
    :ok = LocalEndpoint.detach(one)
    assert StreamDemand.merged(gateway, @key).messages == %{30 => 2.0}
  end

  test "with the gateway's own requests off, everything is forwarded" do
    {gateway, vehicle} = flying([], heartbeat(1), %{request_streams: false})
    one = client(gateway, "one")
    bytes = says(one, %M.RequestDataStream{target_system: 1, req_message_rate: 4, start_stop: 1})
    assert heard(vehicle) == bytes
    assert StreamDemand.list(gateway, @key) == []
  end

  test "a client that only may read notes nothing" do
    {gateway, _vehicle} = flying()
    {:ok, endpoint} = LocalEndpoint.attach(gateway, id: "reader", side: :client, role: :read_only)
    says(endpoint, set(30, 10))
    assert StreamDemand.list(gateway, @key) == []
  end

  test "X6: over a link of high latency go commands, and nothing else" do
    {gateway, vehicle} = flying(options: [high_latency: true])
    one = client(gateway, "one")
    eventually(fn -> match?(%{high_latency: %{only?: true}}, Store.vehicle(gateway, @key)) end)
    says(one, %M.ParamRequestList{target_system: 1, target_component: 1})
    says(one, %M.RequestDataStream{target_system: 1, target_component: 1, req_message_rate: 4, start_stop: 1})
    says(one, set(30, 10))
    bytes = says(one, %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 1.0})
    assert heard(vehicle) == bytes
    assert_receive {:forward, [answer], :ack}
    assert {[ack], _} = Parser.push_datagram(Parser.new(), answer, nil)
    # Not now.
    assert {:ok, %M.CommandAck{command: 511, result: 1}} = MavCodec.decode(ack)
    assert StreamDemand.list(gateway, @key) == []
  end

  test "X6: who lists the messages that may go to such a link has thought of it" do
    router = [out: %{allow_messages: ["PARAM_REQUEST_LIST"]}]
    {gateway, vehicle} = flying(options: [high_latency: true, router: router])
    one = client(gateway, "one")
    says(one, %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 1.0})
    bytes = says(one, %M.ParamRequestList{target_system: 1, target_component: 1})
    assert heard(vehicle) == bytes
  end

  test "X6: a vehicle that only sends summaries is a vehicle" do
    {gateway, _socket} = flying([], summary())
    assert %{vehicle_type: "copter", high_latency: %{only?: true}} = Store.vehicle(gateway, @key)
  end

  test "X6: a link that brings nothing but summaries is found out, and ordinary again with the first heartbeat" do
    {gateway, vehicle} = flying([], summary())
    one = client(gateway, "one")
    link = fn -> Enum.find(MavRouter.Router.endpoints(gateway), &(&1.side == :vehicle)) end
    assert link.().high_latency
    # Frame by frame: a command that only asks for more to be sent is none that such a link carries.
    says(one, %M.ParamRequestList{target_system: 1, target_component: 1})
    says(one, %M.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 148.0})
    says(one, %M.Heartbeat{type: 6, autopilot: 8})
    bytes = says(one, %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 1.0})
    assert heard(vehicle) == bytes
    assert link.().counters.spared == 3

    {:ok, {_address, port}} = :inet.sockname(vehicle)
    now = System.os_time(:microsecond)
    {frames, _} = Parser.push_datagram(Parser.new(), heartbeat(1), now)
    %{id: {id, peer}} = link.()
    assert {_address, ^port} = peer
    Aerie.Reader.deliver(gateway, %{id: id, network: "main", peer: peer}, frames)
    refute link.().high_latency
    bytes = says(one, %M.ParamRequestList{target_system: 1, target_component: 1})
    assert heard(vehicle) == bytes

    # One summary among heartbeats changes nothing; one that comes long after the last of them does.
    again = fn us ->
      {frames, _} = Parser.push_datagram(Parser.new(), summary(), now + us)
      Aerie.Reader.deliver(gateway, %{id: id, network: "main", peer: peer}, frames)
      link.().high_latency
    end

    refute again.(5_000_000)
    assert again.(12_000_000)
  end

  defp summary do
    summary = %M.HighLatency2{
      type: 2,
      autopilot: 3,
      latitude: 473_977_415,
      longitude: 85_455_929,
      battery: 80
    }

    MavCodec.encode(summary, system: 1, component: 1)
  end
end
