defmodule MavRouter.Forward.GateTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import ExUnit.CaptureLog

  alias MavRouter.Router
  alias MavRouter.Endpoints.Access
  alias MavCodec.Messages

  @patience Aerie.Patience.ms()

  # Two vehicles that call the same link, which nobody may command by, and a client that may.
  @moduletag capture_log: true

  setup do
    gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}})
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio", options: [router: [gcs: :deny]])
    [one, two] = for system <- [1, 2], do: vehicle(gateway, port, system)
    {:ok, "gcs"} = MavRouter.Client.add(gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    {:ok, gateway: gateway, port: port, one: one, two: two, client: udp(snapshot(gateway, "gcs").port)}
  end

  defp vehicle(gateway, port, system) do
    socket = udp(port)
    say(socket, heartbeat(system))
    eventually(fn -> Router.route(gateway, {"main", system}) end)
    socket
  end

  defp udp(port) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    socket
  end

  defp say(socket, bytes), do: :ok = :gen_udp.send(socket, bytes)
  defp gcs(system), do: heartbeat(system, type: 6, autopilot: 8, component: 190)

  defp disarm(target, system \\ 255, command \\ 400) do
    MavCodec.encode(
      %Messages.CommandLong{target_system: target, target_component: 1, command: command, param2: 21_196.0},
      system: system,
      component: 190
    )
  end

  # What comes up to a mark of a client that may send it; what is refused is not among it.
  defp until_marked(c, socket) do
    mark = mark(System.unique_integer([:positive]))
    say(c.client, mark)
    until(socket, mark)
  end

  defp until(socket, mark, before \\ []) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
    if bytes == mark, do: Enum.reverse(before), else: until(socket, mark, [bytes | before])
  end

  defp mark(n), do: MavCodec.encode(%Messages.AdsbVehicle{icao_address: n}, system: 254, component: 190)

  defp counters(c), do: snapshot(c.gateway, "radio").counters

  defp counted(c, name, n), do: eventually(fn -> Map.fetch!(counters(c), name) == n end)

  test "a program that calls a link may command no vehicle, whatever it says it is", c do
    log =
      capture_log(fn ->
        strangers =
          for {say_first, n} <- Enum.with_index([[], [gcs(255)], [heartbeat(77)]]) do
            stranger = udp(c.port)
            Enum.each(say_first, &say(stranger, &1))
            for target <- [1, 2, 0], do: say(stranger, disarm(target, 250 + n))
            stranger
          end

        counted(c, :denied, 9)

        for vehicle <- [c.one, c.two], got = until_marked(c, vehicle), n <- 0..2, target <- [1, 2, 0] do
          refute disarm(target, 250 + n) in got
        end

        Enum.each(strangers, &:gen_udp.close/1)
      end)

    # Told once, however often.
    assert [_before, after_first] = String.split(log, "may not command vehicles by this link")
    assert after_first =~ "gcs: allow"
  end

  test "the first command that is refused is answered with DENIED, and no more than one a second", c do
    stranger = udp(c.port)
    began = System.monotonic_time(:millisecond)
    for _times <- 1..5, do: say(stranger, disarm(1))
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(stranger, 0, @patience)
    frame = MavCodec.Frame.from_bytes(bytes, nil)
    assert {:ok, %Messages.CommandAck{command: 400, result: 2, target_system: 255}} = MavCodec.decode(frame)
    assert {frame.system, frame.component} == {1, 1}
    counted(c, :denied, 5)
    # One more for each second that the five took.
    more = div(System.monotonic_time(:millisecond) - began, 1_000)
    say(c.one, attitude(1, 1))
    assert length(until(stranger, attitude(1, 1))) <= more
  end

  test "a stranger and another vehicle reach a vehicle with nothing: sticks, batteries, traffic, approvals, unknown ids",
       c do
    encode = &MavCodec.encode(&1, system: &2, component: &3)

    frames = [
      gcs(255),
      heartbeat(255),
      encode.(%Messages.RcChannels{chancount: 16, chan1_raw: 1_234}, 255, 250),
      # In the vehicle's own system.
      encode.(%Messages.BatteryStatus{battery_remaining: 1}, 1, 190),
      encode.(%Messages.CommandAck{command: 3_001, target_system: 1, target_component: 1}, 250, 1),
      encode.(%Messages.FollowTarget{lat: 7}, 255, 190),
      encode.(%Messages.AdsbVehicle{icao_address: 7}, 255, 190),
      encode.(%Messages.UtmGlobalPosition{lat: 7}, 255, 190),
      encode.(%Messages.Collision{id: 7}, 255, 190),
      encode.(%Messages.GlobalPositionInt{lat: 7}, 255, 190),
      encode.(%Messages.OpenDroneIdArmStatus{}, 1, 190),
      encode.(%Messages.Odometry{x: 1.0}, 255, 190),
      encode.(%Messages.Timesync{ts1: 7}, 255, 190),
      encode.(%Messages.ParamRequestList{target_system: 1, target_component: 1}, 255, 190),
      encode.(%Messages.RadioRcChannels{target_system: 1, target_component: 1, count: 4}, 255, 190),
      <<0xFD, 3, 0, 0, 1, 255, 190, 0xABCDEF::24-little, 1, 1, 5, 9, 9>>
    ]

    for first <- [[], [heartbeat(77)]] do
      sender = udp(c.port)
      Enum.each(first ++ frames, &say(sender, &1))
    end

    eventually(fn -> counters(c).frames_in >= 2 * length(frames) + 3 end)

    say(c.client, mark(7))
    heartbeats = [heartbeat(1), heartbeat(2), heartbeat(77)]
    for vehicle <- [c.one, c.two], do: assert(until(vehicle, mark(7)) -- heartbeats == [])
  end

  test "a sender that poses as a vehicle does not reach one that has just come, before its first heartbeat",
       c do
    liar = udp(c.port)
    say(liar, heartbeat(77))
    eventually(fn -> Router.route(c.gateway, {"main", 77}) end)
    fresh = udp(c.port)
    say(fresh, attitude(3, 1))
    eventually(fn -> Router.route(c.gateway, {"main", 3}) end)
    for target <- [3, 0], do: say(liar, disarm(target, 77))
    sticks = MavCodec.encode(%Messages.RcChannels{chancount: 16}, system: 77, component: 250)
    say(liar, sticks)
    counted(c, :denied, 2)
    say(liar, attitude(77, 9))
    got = until(fresh, attitude(77, 9))
    refute disarm(3, 77) in got or disarm(0, 77) in got or sticks in got
  end

  test "an autopilot may command parts of its vehicle that have an endpoint of their own", c do
    gimbal = udp(c.port)
    say(gimbal, heartbeat(1, type: 26, autopilot: 8, component: 154))
    eventually(fn -> Router.route(c.gateway, {"main", 1}, component: 154) end)

    order =
      MavCodec.encode(%Messages.CommandLong{target_system: 1, target_component: 154, command: 1_000},
        system: 1,
        component: 1
      )

    say(c.one, order)
    until(gimbal, order)
    assert counters(c).denied == 0
  end

  test "what a part has to tell its autopilot goes there on a link with parts: true, and nothing else does",
       c do
    gimbal = udp(c.port)
    hello = heartbeat(1, type: 26, autopilot: 8, component: 154)
    say(gimbal, hello)
    eventually(fn -> Router.route(c.gateway, {"main", 1}, component: 154) end)

    [status, battery, sticks, approval] =
      for message <- [
            %Messages.GimbalDeviceAttitudeStatus{flags: 7},
            %Messages.BatteryStatus{battery_remaining: 50},
            %Messages.RcChannels{chancount: 16},
            %Messages.CommandAck{command: 3_001, target_system: 1, target_component: 1}
          ],
          do: MavCodec.encode(message, system: 1, component: 154)

    Enum.each([status, battery], &say(gimbal, &1))
    eventually(fn -> counters(c).withheld >= 3 end)
    assert until_marked(c, c.one) -- [heartbeat(2)] == []

    :ok = Router.configure(c.gateway, "radio", parts: true)
    Enum.each([sticks, approval, hello, status, battery], &say(gimbal, &1))
    assert until(c.one, battery) == [hello, status]
  end

  defp known(c, system \\ 1) do
    Aerie.Base.Store.put_vehicle(c.gateway, {"main", system}, %{
      id: "V#{system}",
      key: {"main", system},
      network: "main",
      system_id: system
    })
  end

  # A receiver, a camera, a companion … of vehicle 1 on a link of its own.
  defp part(c, component, options \\ []) do
    id = "part-#{component}"
    router = Keyword.merge([gcs: :deny, parts: true], options)
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: id, options: [router: router])
    socket = udp(port)
    say(socket, heartbeat(1, type: 18, autopilot: 8, component: component))
    heard(c, 1, component)
    known(c, 1)
    known(c, 2)
    socket
  end

  defp heard(c, system, component) do
    eventually(fn ->
      match?(%{components: %{^component => _}}, Aerie.Base.Store.system(c.gateway, {"main", system}))
    end)
  end

  defp of_part(message, component, system \\ 1),
    do: MavCodec.encode(message, system: system, component: component)

  test "a vehicle's own receivers and modules reach it on a link with parts: true, and no other vehicle", c do
    for {component, messages} <- [
          {156, [%Messages.AdsbVehicle{icao_address: 9}]},
          {236, [%Messages.OpenDroneIdLocation{latitude: 5}, %Messages.OpenDroneIdArmStatus{status: 1}]},
          {220, [%Messages.GpsInput{lat: 5}, %Messages.GpsRtcmData{len: 3}]},
          {191, [%Messages.NamedValueFloat{value: 2.0}, %Messages.Odometry{x: 7.0}]}
        ] do
      socket = part(c, component)
      bytes = for message <- messages, do: of_part(message, component)
      Enum.each(bytes, &say(socket, &1))

      came = until(c.one, List.last(bytes))
      assert Enum.filter(came, &(&1 in bytes)) == bytes -- [List.last(bytes)]
      assert Enum.filter(until_marked(c, c.two), &(&1 in bytes)) == []
    end
  end

  test "a companion commands its own system and no other on a link with parts: true; other parts ask", c do
    companion = part(c, 191)
    camera = part(c, 100)

    arm = fn target ->
      %Messages.CommandLong{target_system: target, target_component: 1, command: 400, param1: 1.0}
    end

    ask = %Messages.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 242.0}

    rate = %Messages.CommandLong{
      target_system: 1,
      target_component: 1,
      command: 511,
      param1: 30.0,
      param2: 1.0e5
    }

    read = %Messages.ParamRequestRead{target_system: 1, target_component: 1, param_index: 3}
    move = %Messages.SetPositionTargetLocalNed{target_system: 1, target_component: 1, vx: 1.0}

    allowed =
      for(message <- [ask, rate, read], do: {camera, of_part(message, 100)}) ++
        for message <- [ask, arm.(1), move], do: {companion, of_part(message, 191)}

    refused =
      for(message <- [arm.(1), move], do: {camera, of_part(message, 100)}) ++
        for message <- [arm.(2), arm.(0), %{move | target_system: 2}], do: {companion, of_part(message, 191)}

    # In one turn, and the last one is allowed: what is refused before it would have come before it.
    for {socket, bytes} <- refused, do: say(socket, bytes)
    eventually(fn -> snapshot(c.gateway, "part-191").counters.denied >= 3 end)
    eventually(fn -> snapshot(c.gateway, "part-100").counters.denied >= 2 end)

    for {socket, bytes} <- allowed do
      say(socket, bytes)

      assert Enum.filter(until(c.one, bytes), &(&1 in Enum.map(refused, fn {_socket, bytes} -> bytes end))) ==
               []
    end

    said = Enum.map(allowed ++ refused, &elem(&1, 1))
    assert Enum.filter(until_marked(c, c.two), &(&1 in said)) == []
  end

  test "who says that it is the companion of several vehicles commands none of them", c do
    companion = part(c, 191)
    say(companion, heartbeat(2, type: 18, autopilot: 8, component: 191))
    heard(c, 2, 191)

    for system <- [1, 2] do
      order = %Messages.CommandLong{target_system: system, target_component: 1, command: 400, param1: 1.0}
      say(companion, of_part(order, 191, system))
    end

    eventually(fn -> snapshot(c.gateway, "part-191").counters.denied >= 2 end)

    came = until_marked(c, c.one) ++ until_marked(c, c.two)

    assert [] ==
             for(
               bytes <- came,
               MavCodec.Frame.from_bytes(bytes, nil).id == Messages.CommandLong.id(),
               do: bytes
             )
  end

  test "a viewer's question goes on in the gateway's own words, if each number is one", c do
    known(c)
    stranger = udp(c.port)
    say(stranger, gcs(255))

    ask = fn module, fields ->
      message = struct!(module, [target_system: 1, target_component: 1, command: 512] ++ fields)
      say(stranger, MavCodec.encode(message, system: 255, component: 190))
      {:ok, %Messages.CommandAck{command: 512, result: result}} = until_decoded(stranger, Messages.CommandAck)
      result
    end

    wrong = [:nan, :infinity, {:nan, 0x7F800001}, 33.5, -1.0, 1.0e9]

    for value <- wrong,
        module <- [Messages.CommandLong, Messages.CommandInt],
        do: assert(ask.(module, param1: value) == 2)

    for n <- 2..4, do: assert(ask.(Messages.CommandLong, [{:param1, 33.0}, {:"param#{n}", 0.5}]) == 2)
    assert ask.(Messages.CommandLong, param1: 33.0, param7: 3.0) == 2
    assert ask.(Messages.CommandInt, param1: 33.0, z: :neg_infinity) == 2
    assert ask.(Messages.CommandLong, param1: 33.0, param2: :nan, param7: :nan, confirmation: 7) == 0
    assert ask.(Messages.CommandInt, param1: 33.0, x: 5, frame: 200, current: 9) == 0

    asked =
      for bytes <- until_marked(c, c.one),
          {:ok, %module{} = message} <- [MavCodec.decode(MavCodec.Frame.from_bytes(bytes, nil))],
          module != Messages.Heartbeat,
          do: message

    plain = %Messages.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 33.0}
    assert asked == [plain, %{plain | param5: 5.0}]
  end

  test "V1: a sender of MAVLink 1 is answered in it, and asked for in it", c do
    known(c)
    stranger = udp(c.port)
    ask = %Messages.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 33.0}

    for {message, result} <- [{ask, 0}, {%{ask | command: 400, param1: 0.0}, 2}] do
      say(stranger, MavCodec.encode(message, system: 255, component: 190, version: 1))
      {:ok, {_address, _port, bytes}} = :gen_udp.recv(stranger, 0, @patience)
      frame = MavCodec.Frame.from_bytes(bytes, nil)
      assert frame.version == 1
      assert {:ok, %Messages.CommandAck{result: ^result}} = MavCodec.decode(frame)
    end

    question = MavCodec.encode(ask, system: 245, component: 191, version: 1)
    assert question in until_marked(c, c.one)
  end

  defp until_decoded(socket, module) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)

    case MavCodec.decode(MavCodec.Frame.from_bytes(bytes, nil)) do
      {:ok, %^module{}} = decoded -> decoded
      _another -> until_decoded(socket, module)
    end
  end

  test "the gateway asks for senders that may not ask themselves, within a budget", c do
    known(c)
    stranger = udp(c.port)
    say(stranger, gcs(255))

    version = %Messages.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 148.0}
    list = %Messages.ParamRequestList{target_system: 1, target_component: 1}

    for _many <- 1..100,
        message <- [version, list],
        do: say(stranger, MavCodec.encode(message, system: 255, component: 190))

    # Most of them find the budget used up.
    eventually(fn -> counters(c).withheld >= 20 end)

    asked =
      for bytes <- until_marked(c, c.one),
          frame = MavCodec.Frame.from_bytes(bytes, nil),
          {:ok, %module{}} <- [MavCodec.decode(frame)],
          module != Messages.Heartbeat,
          do: {frame.system, module}

    # The gateway's own id; one list, and some single questions.
    assert Enum.all?(asked, fn {system, _module} -> system == 245 end)
    assert Enum.count(asked, &(&1 == {245, Messages.ParamRequestList})) == 1
    assert Enum.count(asked, &(&1 == {245, Messages.CommandLong})) in 1..20

    # The vehicle acknowledges to the gateway, so the gateway does so to the one who asked.
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(stranger, 0, @patience)
    frame = MavCodec.Frame.from_bytes(bytes, nil)
    assert {:ok, %Messages.CommandAck{command: 512, result: 0}} = MavCodec.decode(frame)
  end

  test "answers of vehicles reach who asked; files may not be written", c do
    stranger = udp(c.port)
    say(stranger, gcs(255))

    file = fn system, target ->
      MavCodec.encode(%Messages.FileTransferProtocol{target_system: target}, system: system, component: 1)
    end

    say(stranger, file.(255, 1))
    counted(c, :denied, 1)
    say(c.one, file.(1, 255))
    say(c.one, attitude(1, 1))
    assert file.(1, 255) in until(stranger, attitude(1, 1))
  end

  test "clients may command, and so may callers of a link with gcs: allow, from the next frame on",
       c do
    say(c.client, gcs(254))
    say(c.client, disarm(1, 254))
    assert gcs(254) in until(c.one, disarm(1, 254))

    :ok = Router.configure(c.gateway, "radio", gcs: :allow)
    stranger = udp(c.port)
    say(stranger, disarm(1))
    until(c.one, disarm(1))
    assert counters(c).denied == 0
  end

  test "by default only this machine may command by a link", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "auto", network: "north")
    vehicle = vehicle_of(c.gateway, port, "north", 9)
    stranger = udp(port)
    say(stranger, disarm(9))
    until(vehicle, disarm(9))

    {:ok, owner} = MavRouter.Endpoints.Owner.new("radio", [])

    from = fn text ->
      Access.commands?(
        MavRouter.Endpoints.Endpoint.new(c.gateway, {"radio", 1}, kind: :link, text: text),
        owner
      )
    end

    assert from.("127.0.0.1:40000")
    refute from.("192.168.1.66:40000")
    refute from.("/dev/ttyUSB0")

    assert Access.loopback?("127.0.0.1:14550")
    assert Access.loopback?("127.9.9.9:14550")
    assert Access.loopback?("[::1]:14550")
    assert Access.loopback?("[::ffff:127.0.0.1]:14550")

    for text <- [
          "192.168.1.66:14550",
          "127.0.0.1.example.org:14550",
          "127.0.0.1",
          "/dev/ttyUSB0",
          "[::2]:1",
          "",
          nil
        ],
        do: refute(Access.loopback?(text))
  end

  defp vehicle_of(gateway, port, network, system) do
    socket = udp(port)
    say(socket, heartbeat(system))
    eventually(fn -> Router.route(gateway, {network, system}) end)
    socket
  end

  test "a request for rates from an endpoint that may not command is neither noted nor answered", c do
    stranger = udp(c.port)
    say(stranger, gcs(255))

    interval =
      MavCodec.encode(
        %Messages.CommandLong{
          target_system: 1,
          target_component: 1,
          command: 511,
          param1: 30.0,
          param2: 1.0e6
        },
        system: 255,
        component: 190
      )

    say(stranger, interval)
    counted(c, :denied, 1)
  end

  test "the log tells a vehicle from a ground station", c do
    log =
      capture_log(fn ->
        say(c.one, MavCodec.encode(%Messages.Data16{type: 1}, system: 1, component: 1))
        counted(c, :denied, 1)
      end)

    assert log =~ "says that it is a vehicle"
    refute log =~ "gcs: allow"
  end
end
