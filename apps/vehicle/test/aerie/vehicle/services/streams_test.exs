defmodule Aerie.Vehicle.Services.StreamsTest do
  @moduledoc "Demand of clients, and their own requests to a vehicle."
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Services.StreamDemand
  alias Aerie.Vehicle.Services.Streams
  alias Aerie.Vehicle.Services.Streams.Intercept
  alias MavCodec.Messages, as: M

  @key {"main", 1}
  @second 1_000_000

  defp gateway do
    gateway = start_gateway(%{}, with: [:router])
    heartbeat = frame(%M.Heartbeat{type: 2, autopilot: 3}, @second)
    Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, [heartbeat])
    eventually(fn -> Store.vehicle(gateway, @key) end)
    gateway
  end

  defp session(gateway), do: :sys.get_state(Names.via(gateway, :session, @key), Aerie.Patience.ms())
  defp wanted(gateway), do: session(gateway).core.streams.demand

  defp set(id, hz, target \\ 1) do
    %M.CommandLong{
      target_system: 1,
      target_component: target,
      command: 511,
      param1: id * 1.0,
      param2: 1_000_000.0 / hz
    }
  end

  defp from_client(message), do: frame(message, @second, system: 255, component: 190)

  defp intercept(gateway, client, message),
    do: Streams.intercept(gateway, "main", client, from_client(message))

  test "the highest rate of all clients counts, and survives the session" do
    gateway = gateway()
    :ok = Streams.want(gateway, @key, :map, 30, 5)
    :ok = Streams.want(gateway, @key, :chart, 30, 20)
    :ok = Streams.want(gateway, @key, :chart, 74, 2)
    assert wanted(gateway) == %{30 => 20, 74 => 2}
    session = Names.whereis(gateway, :session, @key)
    Process.exit(session, :kill)
    eventually(fn -> Names.whereis(gateway, :session, @key) not in [nil, session] end)
    assert wanted(gateway) == %{30 => 20, 74 => 2}
    :ok = Streams.want(gateway, @key, :chart, 74, nil)
    :ok = Streams.forget(gateway, :chart)
    assert wanted(gateway) == %{30 => 5}
  end

  test "the demand of a client ends with its process" do
    gateway = gateway()
    client = spawn(fn -> receive do: (:stop -> :ok) end)
    :ok = Streams.want(gateway, @key, {client, "ws"}, 30, 20)
    refute StreamDemand.sweep(gateway, @key)
    ref = Process.monitor(client)
    send(client, :stop)
    assert_receive {:DOWN, ^ref, _, _, _}
    assert StreamDemand.sweep(gateway, @key)
    assert StreamDemand.list(gateway, @key) == []
  end

  test "a client cannot fill the table" do
    gateway = gateway()
    results = for id <- 1..2_100, do: Streams.want(gateway, @key, :flood, id, 1)
    assert {:error, :too_many} in results
    assert length(StreamDemand.list(gateway, @key)) == 2_048
    assert Store.counter(gateway, {:wants, :refused}) > 0
    # Clients that are there already are not affected.
    assert Streams.want(gateway, @key, :flood, 1, 9) == :ok
  end

  describe "a client's own request" do
    test "that lowers no rate is forwarded and recorded" do
      gateway = gateway()
      assert intercept(gateway, :one, set(30, 10)) == :forward
      assert wanted(gateway) == %{30 => 10.0}
      assert %{set: 10.0, state: :asked} = session(gateway).core.streams.messages[30]
    end

    test "M2: that would lower another's rate is answered in the vehicle's name" do
      gateway = gateway()
      :ok = Streams.want(gateway, @key, :other, 30, 20)
      assert {:absorb, answer} = intercept(gateway, :one, set(30, 4))
      {[ack], _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), answer, nil)
      assert {ack.system, ack.component} == {1, 1}

      assert {:ok, %M.CommandAck{command: 511, result: 0, target_system: 255, target_component: 190}} =
               MavCodec.decode(ack)

      # Its own demand is its last request.
      assert {:one, 30, 4.0} in StreamDemand.list(gateway, @key)
      assert wanted(gateway) == %{30 => 20}
    end

    test "to stop a message that the gateway needs is absorbed, to stop any other is forwarded" do
      gateway = gateway()
      stop = fn id -> %{set(id, 1) | param2: -1.0} end
      assert {:absorb, _ack} = intercept(gateway, :one, stop.(33))
      assert intercept(gateway, :one, stop.(36)) == :forward
      assert wanted(gateway) == %{}
    end

    test "M1: REQUEST_DATA_STREAM is recorded, not forwarded, and has no answer" do
      gateway = gateway()

      request = %M.RequestDataStream{
        target_system: 1,
        target_component: 1,
        req_stream_id: 10,
        req_message_rate: 4
      }

      assert intercept(gateway, :one, %{request | start_stop: 1}) == {:absorb, nil}
      assert session(gateway).core.streams.groups == %{10 => 4}
      assert intercept(gateway, :one, %{request | req_stream_id: 0, start_stop: 1}) == {:absorb, nil}
      assert map_size(session(gateway).core.streams.groups) == 7
      assert intercept(gateway, :one, %{request | req_stream_id: 0, start_stop: 0}) == {:absorb, nil}
      assert session(gateway).core.streams.groups == %{}
    end

    test "is forwarded if it is not for a known vehicle's autopilot, or requests no rate" do
      gateway = gateway()
      assert intercept(gateway, :one, %{set(30, 4) | target_system: 9}) == :forward
      assert intercept(gateway, :one, %{set(30, 4) | target_system: 0}) == :forward
      assert intercept(gateway, :one, set(30, 4, 154)) == :forward
      assert intercept(gateway, :one, %{set(30, 4) | param1: -1.0}) == :forward
      assert intercept(gateway, :one, %{set(30, 4) | param2: :nan}) == :forward
      assert intercept(gateway, :one, %{set(30, 4) | command: 400}) == :forward
      assert wanted(gateway) == %{}
      assert intercept(gateway, :one, set(30, 4, 0)) == :forward
      assert wanted(gateway) == %{30 => 4.0}
    end

    test "is recognised by its first bytes, in both versions and both kinds of command" do
      int = %M.CommandInt{target_system: 1, command: 511, param1: 30.0, param2: 1.0e5}

      for message <- [set(30, 4), int, %M.RequestDataStream{target_system: 1}], version <- [1, 2] do
        assert Streams.request?(frame(message, @second, version: version))
      end

      for message <- [%{set(30, 4) | command: 512}, %M.Heartbeat{}, %M.CommandLong{}, %M.ParamRequestList{}] do
        refute Streams.request?(frame(message, @second))
      end
    end
  end

  test "whatever is requested: nothing is forwarded that lowers the rate of another client" do
    hz = :proper_types.range(1, 50)
    wants = :proper_types.list({:proper_types.oneof([30, 33, 36, 74]), hz})

    prop =
      :proper.forall(
        {wants, :proper_types.oneof([30, 33, 36, 74]), hz, :proper_types.oneof([1, 0, -1])},
        fn {others, id, hz, sign} ->
          others = %{messages: Map.new(others), groups: %{}}
          request = if sign == 1, do: set(id, hz), else: %{set(id, 1) | param2: sign * 1.0}

          case Intercept.decide(request, others) do
            {:forward, ^id, wanted} -> (wanted || 0) >= Map.get(others.messages, id, 0)
            {:absorb, ^id, wanted} -> (wanted || 0) < max(Map.get(others.messages, id, 0), 0.5)
          end
        end
      )

    assert :proper.quickcheck(prop, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end
end
