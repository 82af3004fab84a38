defmodule Aerie.Vehicle.SystemIdsTest do
  @moduledoc "Vehicles with ids at the edges: those of ground stations, ours, and those of more than a byte."
  use Aerie.VehicleCase, async: true

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Router
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Services.Streams
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M

  @loopback {127, 0, 0, 1}
  @patience Aerie.Patience.ms()

  # A gateway with one vehicle on one UDP link, which the test plays.
  defp flying(system, mavlink \\ %{}) do
    config = %{
      mavlink: Map.merge(%{system_id: 245, component_id: 191, dialects: [:all], sysid32: true}, mavlink)
    }

    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0")
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: false])
    vehicle = %{gateway: gateway, socket: socket, port: port, system: system, key: {"main", system}}
    beat(vehicle)
    session = eventually(fn -> Names.whereis(gateway, :session, vehicle.key) end)
    Map.merge(vehicle, %{session: session, monitor: Process.monitor(session)})
  end

  defp beat(vehicle), do: say(vehicle, %M.Heartbeat{type: 2, autopilot: 3, system_status: 3})

  defp say(vehicle, message) do
    bytes = MavCodec.encode(message, system: vehicle.system, component: 1, sysid32: true)
    :ok = :gen_udp.send(vehicle.socket, @loopback, vehicle.port, bytes)
  end

  # The next frame to the vehicle that the function wants; it beats meanwhile.
  defp asked(vehicle, wanted?, deadline \\ System.monotonic_time(:millisecond) + @patience) do
    if System.monotonic_time(:millisecond) > deadline, do: flunk("it was not asked")

    with {:ok, {_ip, _port, bytes}} <- :gen_udp.recv(vehicle.socket, 0, 300),
         {frames, _parser} = Parser.push_datagram(Parser.new(sysid32: true), bytes),
         %Frame{} = frame <- Enum.find(frames, &wanted?.(decoded(&1), &1)) do
      {frame, decoded(frame)}
    else
      _nothing ->
        beat(vehicle)
        asked(vehicle, wanted?, deadline)
    end
  end

  defp decoded(frame), do: frame |> MavCodec.decode() |> elem(1)

  for system <- [200, 245, 254, 255, 256, 300, 70_000] do
    test "N3: a vehicle with id #{system} is heard, asked for its streams and its time, and answered" do
      vehicle = flying(unquote(system))
      gateway = vehicle.gateway

      {frame, %{target_component: 1}} = asked(vehicle, &match?({%M.CommandLong{command: 511}, _}, {&1, &2}))
      assert {unquote(system), 1} = Frame.target(frame)
      {frame, _} = asked(vehicle, &match?({%M.Timesync{tc1: 0}, _}, {&1, &2}))
      # It alone is asked, not all that hear it.
      assert {unquote(system), 1} = Frame.target(frame)
      say(vehicle, %M.Timesync{tc1: 0, ts1: 77})
      assert {_, _} = asked(vehicle, &match?({%M.Timesync{ts1: 77}, _}, {&1, &2}))

      # A client's request for a rate is answered in its name.
      :ok = Streams.want(gateway, vehicle.key, :other, 30, 20)
      test = self()

      request = %M.CommandLong{
        target_system: unquote(system),
        target_component: 1,
        command: 511,
        param1: 30.0,
        param2: 1.0e6
      }

      bytes = MavCodec.encode(request, system: 255, component: 190, sysid32: true)
      {[frame], _parser} = Parser.push(Parser.new(sysid32: true), bytes)
      eventually(fn -> map_size(Store.vehicle(gateway, vehicle.key).streams) > 0 end)
      assert {:absorb, answer} = Streams.intercept(gateway, "main", test, frame)
      {[frame], _parser} = Parser.push(Parser.new(sysid32: true), answer)

      assert {frame.system, decoded(frame)} ==
               {unquote(system), %M.CommandAck{command: 511, target_system: 255, target_component: 190}}

      # It did not beat for a while.
      eventually(fn ->
        beat(vehicle)
        match?(%{status: :online}, Store.vehicle(gateway, vehicle.key))
      end)

      assert :ok = Router.send(gateway, vehicle.key, "to it")
      refute_received {:DOWN, _, _, _, _}
      assert Names.whereis(gateway, :session, vehicle.key) == vehicle.session
    end
  end

  test "an operator gives a flying vehicle another id: the new one is there at once, the old one is missed and told" do
    vehicle = flying(1, %{request_streams: true})
    gateway = vehicle.gateway
    PubSub.subscribe(gateway, :events)
    asked(vehicle, &match?({%M.CommandLong{command: 511}, _}, {&1, &2}))

    renamed = %{vehicle | system: 7, key: {"main", 7}}
    beat(renamed)
    eventually(fn -> match?(%{status: :online}, Store.vehicle(gateway, {"main", 7})) end)
    {frame, _} = asked(renamed, &match?({%M.CommandLong{command: 511, target_system: 7}, _}, {&1, &2}))
    assert {7, 1} = Frame.target(frame)
    beating = start_supervised!({Task, fn -> beats(renamed) end})
    assert_receive {:fleet, :events, %{type: "link.lost", vehicle: "VID-001"}}, @patience
    # The event is committed just before the status is shown.
    eventually(fn -> match?(%{status: :lost}, Store.vehicle(gateway, {"main", 1})) end)
    eventually(fn -> match?(%{status: :online}, Store.vehicle(gateway, {"main", 7})) end)
    assert %{collision: nil} = Store.vehicle(gateway, {"main", 7})
    # Its former id is given back: the vehicle is who it was, and the other one is missed.
    stop_supervised!(Task)
    refute Process.alive?(beating)
    start_supervised!({Task, fn -> beats(vehicle) end})
    assert_receive {:fleet, :events, %{type: "link.restored", vehicle: "VID-001"}}, @patience
    assert_receive {:fleet, :events, %{type: "link.lost", vehicle: "VID-007"}}, @patience
    refute_received {:fleet, :events, %{type: "collision"}}
    refute_received {:DOWN, _, _, _, _}
  end

  defp beats(vehicle) do
    beat(vehicle)

    receive do
    after
      300 -> beats(vehicle)
    end
  end
end
