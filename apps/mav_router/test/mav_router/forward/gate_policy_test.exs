defmodule MavRouter.Forward.GatePolicyTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Base.Store
  alias MavRouter.Router
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @patience Aerie.Patience.ms()

  # Refuses commands with an odd number, with one answer, and SET_MODE with a question in its place; tells the test what it was
  # asked.
  defmodule Odd do
    @behaviour MavRouter.Router.Policy

    @impl MavRouter.Router.Policy
    def principal(_gateway, path) do
      may = if path.commands, do: [:telemetry, :sensors, :manual], else: []
      %Aerie.Base.Principal{kind: :client, name: path.owner, may: may}
    end

    # Somebody is in charge of vehicle 2.
    @impl MavRouter.Router.Policy
    def permits?(_gateway, _principal, {_network, system}), do: system != 2

    @impl MavRouter.Router.Policy
    def open?(_gateway, _principal, message), do: message == 0xABCDEF

    @impl MavRouter.Router.Policy
    def decide(gateway, sender, vehicle, frame) do
      {:ok, message} = MavCodec.decode(frame)
      send(:persistent_term.get({__MODULE__, gateway}), {:asked, sender, vehicle, message})

      case message do
        %M.CommandLong{command: command} when rem(command, 2) == 1 ->
          {_network, system} = vehicle

          {:refuse,
           for(
             _heard <- 1..min(system, 1)//1,
             do: MavCodec.encode(%M.CommandAck{command: command, result: 2}, system: system, component: 1)
           ), nil}

        %M.SetMode{target_system: target} ->
          question =
            MavCodec.encode(%M.ParamRequestList{target_system: target},
              system: frame.system,
              component: frame.component
            )

          {:refuse, [], Frame.from_bytes(question, MavCodec.Dialects.All.crc_extra(21))}

        %M.Tunnel{payload_type: type} when rem(type, 2) == 1 ->
          {:refuse, [], nil}

        _even ->
          :forward
      end
    end
  end

  setup do
    gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}}, options: [policy: Odd])
    :persistent_term.put({Odd, gateway}, self())
    on_exit(fn -> :persistent_term.erase({Odd, gateway}) end)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {:ok, gateway: gateway, port: port, one: vehicle(gateway, port, 1), two: vehicle(gateway, port, 2)}
  end

  defp vehicle(gateway, port, system) do
    socket = udp(port)
    say(socket, heartbeat(system))
    eventually(fn -> Router.route(gateway, {"main", system}) end)

    Store.put_vehicle(gateway, {"main", system}, %{
      id: "V#{system}",
      key: {"main", system},
      network: "main",
      system_id: system
    })

    socket
  end

  defp client(c, settings \\ %{}) do
    {:ok, "gcs"} =
      MavRouter.Client.add(c.gateway, Map.merge(%{url: "udpin:127.0.0.1:0", id: "gcs"}, settings))

    udp(snapshot(c.gateway, "gcs").port)
  end

  defp udp(port) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    socket
  end

  defp say(socket, bytes) when is_binary(bytes), do: :ok = :gen_udp.send(socket, bytes)
  defp say(socket, message), do: say(socket, MavCodec.encode(message, system: 255, component: 190))

  defp next(socket) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
    frame = Frame.from_bytes(bytes, nil)
    {:ok, message} = MavCodec.decode(frame)
    if match?(%M.Heartbeat{}, message), do: next(socket), else: {message, frame}
  end

  defp first_unlike(socket, other) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
    if bytes == other, do: first_unlike(socket, other), else: bytes
  end

  test "a refused command is answered and counted, and its place is taken by what the policy sends", c do
    gcs = client(c)

    for command <- [401, 402],
        do: say(gcs, %M.CommandLong{target_system: 1, target_component: 1, command: command})

    say(gcs, %M.SetMode{target_system: 1})
    assert {%M.CommandLong{command: 402}, _frame} = next(c.one)
    assert {%M.ParamRequestList{target_system: 1}, %{system: 255, component: 190}} = next(c.one)
    assert {%M.CommandAck{command: 401, result: 2}, %{system: 1}} = next(gcs)

    assert_receive {:asked, %{owner: "gcs", peer: "127.0.0.1:" <> _, principal: %{name: "gcs"}}, {"main", 1},
                    %M.CommandLong{command: 401}}

    assert snapshot(c.gateway, "gcs").counters.denied == 2
  end

  test "W: a plan that a vehicle on this machine sends is not an order to the gateway, nor to a ground station" do
    gateway = start_parts(%{mavlink: %{system_id: 237, component_id: 191}}, options: [policy: Odd])
    :persistent_term.put({Odd, gateway}, self())
    on_exit(fn -> :persistent_term.erase({Odd, gateway}) end)
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    [one, _two] = for system <- [1, 2], do: vehicle(gateway, port, system)

    for {target, component} <- [{237, 191}, {237, 190}, {255, 190}] do
      say_as(one, %M.MissionItemInt{
        target_system: target,
        target_component: component,
        frame: 0,
        command: 16,
        z: 50.0
      })

      say_as(one, %M.MissionCount{target_system: target, target_component: component, count: 1})
    end

    # Another vehicle's plan is judged.
    say_as(one, %M.MissionItemInt{target_system: 2, target_component: 1, frame: 0, command: 16, z: 50.0})
    assert_receive {:asked, _sender, {"main", 2}, %M.MissionItemInt{}}
    refute_received {:asked, _sender, _vehicle, _message}
  end

  defp say_as(socket, message), do: say(socket, MavCodec.encode(message, system: 1, component: 1))

  test "it is asked for each vehicle of a command to all, and refusing it for one refuses it for all", c do
    gcs = client(c)
    say(gcs, %M.CommandLong{command: 403})
    assert_receive {:asked, _sender, {"main", 1}, _message}
    say(gcs, %M.CommandLong{command: 404})

    for system <- [1, 2],
        do: assert_receive({:asked, _sender, {"main", ^system}, %M.CommandLong{command: 404}})

    # The client itself is none, although it listens.
    refute_received {:asked, _sender, {"main", 0}, _message}

    for vehicle <- [c.one, c.two], do: assert({%M.CommandLong{command: 404}, _frame} = next(vehicle))
  end

  test "a client that sees other ids is judged by the vehicle that it means, and answered from the id that it knows",
       c do
    gcs = client(c, %{id_offsets: %{"main" => 100}})
    say(gcs, %M.CommandLong{target_system: 102, target_component: 1, command: 405})
    assert_receive {:asked, _sender, {"main", 2}, %M.CommandLong{command: 405}}
    assert {%M.CommandAck{command: 405}, %{system: 102}} = next(gcs)
    say(gcs, %M.SetMode{target_system: 102})
    assert {%M.ParamRequestList{target_system: 2}, _frame} = next(c.two)
  end

  test "it is not asked about telemetry, questions, and those who may not command anyway", c do
    gcs = client(c)
    say(c.one, attitude(1, 7))
    say(gcs, %M.ParamRequestList{target_system: 1})
    assert {%M.ParamRequestList{}, _frame} = next(c.one)
    :ok = Router.configure(c.gateway, "gcs", role: :read_only)
    say(gcs, %M.CommandLong{target_system: 1, command: 409})
    say(c.one, attitude(1, 8))
    assert {%M.Attitude{}, _frame} = next(gcs)
    refute_received {:asked, _sender, _vehicle, _message}
  end

  test "a command to all is also judged for vehicles that were not heard yet", c do
    silent = udp(c.port)
    say(silent, attitude(9, 1))
    eventually(fn -> Router.route(c.gateway, {"main", 9}) end)
    gcs = client(c)
    say(gcs, %M.CommandLong{command: 404})
    assert_receive {:asked, _sender, {"main", 0}, %M.CommandLong{command: 404}}
  end

  test "a command to all is also judged for a vehicle whose session has not begun", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "lab", network: "lab")
    starting = udp(port)
    say(starting, heartbeat(5))
    eventually(fn -> Router.route(c.gateway, {"lab", 5}) end)
    gcs = client(c, %{networks: ["lab"]})
    for command <- [403, 404], do: say(gcs, %M.CommandLong{command: command})

    for command <- [403, 404],
        do: assert_receive({:asked, _sender, {"lab", 0}, %M.CommandLong{command: ^command}})

    assert {%M.CommandLong{command: 404}, _frame} = next(starting)
  end

  test "input of estimators needs a permission, and goes to no vehicle that somebody else is in charge of",
       c do
    gcs = client(c)
    input = fn system -> %M.GpsInjectData{target_system: system, target_component: 1, len: 1} end
    say(gcs, input.(2))
    say(gcs, %M.GpsRtcmData{len: 1})
    say(gcs, input.(1))
    assert {%M.GpsInjectData{target_system: 1}, _frame} = next(c.one)
    assert snapshot(c.gateway, "gcs").counters.withheld == 2
    refute_received {:asked, _sender, _vehicle, _message}
  end

  test "a client's sticks are judged by whichever message, telemetry of vehicles included", c do
    gcs = client(c)
    say(gcs, %M.RcChannels{chancount: 16})
    for system <- [1, 2], do: assert_receive({:asked, _sender, {"main", ^system}, %M.RcChannels{}})
    say(c.one, MavCodec.encode(%M.RcChannels{chancount: 16}, system: 1, component: 1))
    assert {%M.RcChannels{}, %{system: 1}} = next(gcs)
    refute_received {:asked, _sender, {"main", 2}, %M.RcChannels{}}
  end

  test "an order that nobody may send reaches no vehicle, and the policy is not asked about it", c do
    gcs = client(c)
    for test <- [%M.TestTypes{u8: 7}, %M.ArrayTest3{}], do: say(gcs, test)
    say(gcs, %M.Tunnel{payload_type: 2, payload_length: 1, payload: <<1>>})
    assert {%M.Tunnel{}, _frame} = next(c.one)
    assert_receive {:asked, _sender, {"main", 1}, message}
    assert %M.Tunnel{} = message
    assert snapshot(c.gateway, "gcs").counters.denied == 2
  end

  test "a message without a row reaches vehicles if the policy opens it", c do
    unknown = &<<0xFD, 3, 0, 0, 1, 255, 190, &1::24-little, 1, 1, 5, 9, 9>>
    gcs = client(c)
    for id <- [0xABCDEE, 0xABCDEF], do: say(gcs, unknown.(id))
    assert first_unlike(c.one, heartbeat(2)) == unknown.(0xABCDEF)
    assert snapshot(c.gateway, "gcs").counters.withheld == 1
  end

  defp command(number, from, to \\ []),
    do: struct!(%M.CommandLong{command: number}, to) |> MavCodec.encode(from)

  test "who says that it is a vehicle, where anybody may command, is asked about like everybody else", c do
    liar = udp(c.port)
    say(liar, heartbeat(77))
    eventually(fn -> Router.route(c.gateway, {"main", 77}) end)

    # As itself, as somebody behind the same router, and as a part of the vehicle that it commands.
    for {system, component} <- [{77, 1}, {255, 190}, {1, 190}], number <- [411, 412] do
      say(
        liar,
        command(number, [system: system, component: component], target_system: 1, target_component: 1)
      )

      assert_receive {:asked, %{owner: "radio"}, {"main", 1}, %M.CommandLong{command: ^number}}
    end

    assert {%M.CommandLong{command: 412}, %{system: 77}} = next(c.one)
    # As the vehicle itself: nobody is asked, because it goes nowhere.
    say(liar, command(412, [system: 1, component: 1], target_system: 1, target_component: 1))
    say(liar, command(414, [system: 77, component: 1], target_system: 1, target_component: 1))
    assert_receive {:asked, %{owner: "radio"}, {"main", 1}, %M.CommandLong{command: 414}}
    refute_received {:asked, _sender, _vehicle, %M.CommandLong{command: 412}}
    # A real vehicle that commands another one is no different.
    say(c.one, command(413, [system: 1, component: 1], target_system: 2))
    assert_receive {:asked, _sender, {"main", 2}, %M.CommandLong{command: 413}}
  end

  test "what an autopilot says to all and may not say to other vehicles still goes to clients", c do
    gcs = client(c)
    say(gcs, heartbeat(255, type: 6, autopilot: 8, component: 190))
    eventually(fn -> Router.route(c.gateway, {"main", 255}) end)

    tunnel =
      &MavCodec.encode(%M.Tunnel{payload_type: &1, payload_length: 1, payload: <<1>>},
        system: 1,
        component: 1
      )

    say(c.one, tunnel.(1))
    assert {%M.Tunnel{payload_type: 1}, _frame} = next(gcs)
    say(c.one, tunnel.(2))
    assert {%M.Tunnel{payload_type: 2}, _frame} = next(gcs)
    assert snapshot(c.gateway, "radio").counters.denied == 1
  end

  test "it is not asked about what a vehicle says to its own parts, to itself and to ground stations", c do
    gimbal = udp(c.port)
    say(gimbal, heartbeat(1, type: 26, autopilot: 8, component: 154))
    eventually(fn -> Router.route(c.gateway, {"main", 1}, component: 154) end)
    gcs = client(c)
    say(gcs, heartbeat(255, type: 6, autopilot: 8, component: 190))
    eventually(fn -> Router.route(c.gateway, {"main", 255}) end)

    say(c.one, command(415, system: 1, component: 1))
    say(c.one, command(417, [system: 1, component: 191], target_system: 1, target_component: 1))
    say(c.one, command(421, [system: 1, component: 1], target_system: 1, target_component: 154))
    say(c.one, command(419, [system: 1, component: 1], target_system: 255))
    assert {%M.CommandLong{command: 419}, _frame} = next(gcs)
    # To all its parts, and to this one; what is for the autopilot does not go back to where it came from.
    assert {%M.CommandLong{command: 415}, _frame} = next(gimbal)
    assert {%M.CommandLong{command: 421}, _frame} = next(gimbal)
    refute_received {:asked, _sender, _vehicle, _message}
  end
end
