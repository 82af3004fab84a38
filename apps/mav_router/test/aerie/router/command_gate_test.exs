defmodule Aerie.Router.GateTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import ExUnit.CaptureLog

  alias Aerie.Router
  alias Aerie.Router.CommandGate
  alias Aerie.Router.ControlMessages
  alias MavCodec.Dialects.All
  alias MavCodec.Messages

  @patience Aerie.Patience.ms()

  # Two vehicles that call the same link, which nobody may command by, and a client that may.
  @moduletag capture_log: true

  setup do
    gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}})
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio", options: [router: [gcs: :deny]])
    [one, two] = for system <- [1, 2], do: vehicle(gateway, port, system)
    {:ok, gateway: gateway, port: port, one: one, two: two}
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

  # What comes up to a mark that everybody may send; what is refused is not among it.
  defp until(socket, mark, before \\ []) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
    if bytes == mark, do: Enum.reverse(before), else: until(socket, mark, [bytes | before])
  end

  defp mark(system),
    do: MavCodec.encode(%Messages.AdsbVehicle{icao_address: 7}, system: system, component: 190)

  defp counters(c), do: snapshot(c.gateway, "radio").counters

  defp counted(c, name, n), do: eventually(fn -> Map.fetch!(counters(c), name) == n end)

  test "a program that calls a link may command no vehicle, whatever it says it is", c do
    log =
      capture_log(fn ->
        for {say_first, n} <- Enum.with_index([[], [gcs(255)], [heartbeat(77)]]) do
          stranger = udp(c.port)
          Enum.each(say_first, &say(stranger, &1))
          for target <- [1, 2, 0], do: say(stranger, disarm(target, 250 + n))
          say(stranger, mark(90 + n))

          for vehicle <- [c.one, c.two], got = until(vehicle, mark(90 + n)), target <- [1, 2, 0] do
            refute disarm(target, 250 + n) in got
          end
        end

        counted(c, :denied, 9)
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
    say(c.one, mark(1))
    assert length(until(stranger, mark(1))) <= more
  end

  test "its heartbeat reaches no vehicle's failsafe, nor does one that poses as a vehicle's", c do
    stranger = udp(c.port)
    say(stranger, gcs(255))
    say(stranger, heartbeat(255))
    say(stranger, mark(255))
    assert until(c.one, mark(255)) |> Enum.filter(&(&1 in [gcs(255), heartbeat(255)])) == []
    assert counters(c).withheld > 0
  end

  test "a vehicle may not command another vehicle nor feed its estimator; other frames pass", c do
    odometry = MavCodec.encode(%Messages.Odometry{x: 1.0}, system: 1, component: 1)
    follow = MavCodec.encode(%Messages.FollowTarget{lat: 7}, system: 1, component: 1)
    say(c.one, disarm(2, 1))
    say(c.one, odometry)
    say(c.one, follow)
    got = until(c.two, follow)
    refute disarm(2, 1) in got
    refute odometry in got
    counted(c, :denied, 1)
    counted(c, :withheld, 1)
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
    say(liar, mark(77))
    got = until(fresh, mark(77))
    refute disarm(3, 77) in got or disarm(0, 77) in got
    counted(c, :denied, 2)
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

  test "questions and their answers pass for an endpoint that may not command", c do
    stranger = udp(c.port)
    say(stranger, gcs(255))

    list =
      MavCodec.encode(%Messages.ParamRequestList{target_system: 1, target_component: 1},
        system: 255,
        component: 190
      )

    version =
      MavCodec.encode(
        %Messages.CommandLong{target_system: 1, target_component: 1, command: 512, param1: 148.0},
        system: 255,
        component: 190
      )

    Enum.each([list, version], &say(stranger, &1))
    say(stranger, mark(255))
    got = until(c.one, mark(255))
    assert list in got and version in got
    # FILE_TRANSFER_PROTOCOL writes, and answers.
    file = fn system, target ->
      MavCodec.encode(%Messages.FileTransferProtocol{target_system: target}, system: system, component: 190)
    end

    say(stranger, file.(255, 1))
    say(c.one, file.(1, 255))
    say(c.one, mark(1))
    assert file.(1, 255) in until(stranger, mark(1))
    counted(c, :denied, 1)
  end

  test "clients may command, and so may callers of a link with gcs: allow, from the next frame on",
       c do
    {:ok, "gcs"} = Aerie.Client.add(c.gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    client = udp(snapshot(c.gateway, "gcs").port)
    say(client, gcs(254))
    say(client, disarm(1, 254))
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

    {:ok, owner} = Router.Owner.new("radio", [])

    from = fn text ->
      CommandGate.open?(Router.Endpoint.new(c.gateway, {"radio", 1}, kind: :link, text: text), owner)
    end

    assert from.("127.0.0.1:40000")
    refute from.("192.168.1.66:40000")
    refute from.("/dev/ttyUSB0")

    assert CommandGate.loopback?("127.0.0.1:14550")
    assert CommandGate.loopback?("127.9.9.9:14550")
    assert CommandGate.loopback?("[::1]:14550")
    assert CommandGate.loopback?("[::ffff:127.0.0.1]:14550")

    for text <- [
          "192.168.1.66:14550",
          "127.0.0.1.example.org:14550",
          "127.0.0.1",
          "/dev/ttyUSB0",
          "[::2]:1",
          "",
          nil
        ],
        do: refute(CommandGate.loopback?(text))
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

  test "every message by which a ground station flies is in the table" do
    for name <-
          ~w(COMMAND_LONG COMMAND_INT SET_MODE PARAM_SET MISSION_COUNT MISSION_ITEM_INT RC_CHANNELS_OVERRIDE MANUAL_CONTROL
                   SET_POSITION_TARGET_GLOBAL_INT SET_ATTITUDE_TARGET FILE_TRANSFER_PROTOCOL SETUP_SIGNING SERIAL_CONTROL) do
      id = All.message_id(name)
      assert ControlMessages.kind(%MavCodec.Frame{frame(id) | payload: <<>>}) == :command
    end

    for name <-
          ~w(ADSB_VEHICLE FOLLOW_TARGET COLLISION GLOBAL_POSITION_INT ATTITUDE COMMAND_ACK PARAM_VALUE PARAM_REQUEST_LIST),
        do: assert(ControlMessages.kind(frame(All.message_id(name))) == nil)
  end

  # Messages with a target that change nothing in who gets them. A new message belongs here or into the table.
  @questions ~w(PARAM_REQUEST_READ PARAM_REQUEST_LIST PARAM_EXT_REQUEST_READ PARAM_EXT_REQUEST_LIST MISSION_REQUEST_PARTIAL_LIST
    MISSION_REQUEST MISSION_REQUEST_INT MISSION_REQUEST_LIST LOG_REQUEST_LIST LOG_REQUEST_DATA LOG_REQUEST_END FENCE_FETCH_POINT
    RALLY_FETCH_POINT AUTOPILOT_VERSION_REQUEST GOPRO_GET_REQUEST REQUEST_EVENT OSD_PARAM_SHOW_CONFIG PING TIMESYNC)
  @answers ~w(COMMAND_ACK MISSION_ACK PARAM_ERROR LOGGING_ACK RESPONSE_EVENT_ERROR SUPPORTED_TUNES CUBEPILOT_FIRMWARE_UPDATE_RESP)
  @telemetry ~w(MOUNT_STATUS CAMERA_STATUS CAMERA_FEEDBACK GIMBAL_REPORT GIMBAL_TORQUE_CMD_REPORT GIMBAL_DEVICE_ATTITUDE_STATUS
    REMOTE_LOG_DATA_BLOCK LOGGING_DATA LOGGING_DATA_ACKED MLRS_RADIO_LINK_INFORMATION)

  test "every message with a target is in the table, or somebody decided that it changes no vehicle" do
    undecided =
      for id <- All.ids(),
          match?({system, _component} when system != nil, All.targets(id)),
          ControlMessages.kind(%MavCodec.Frame{frame(id) | payload: <<>>}) == nil,
          do: All.name(id)

    assert Enum.sort(undecided) == Enum.sort(@questions ++ @answers ++ @telemetry)
  end

  test "sticks, set-ups and what an estimator believes have many names" do
    kind = &ControlMessages.kind(frame(All.message_id(&1)))

    for name <-
          ~w(RADIO_RC_CHANNELS CUBEPILOT_RAW_RC ASL_OBCTRL WIFI_CONFIG_AP CELLULAR_CONFIG UAVIONIX_ADSB_OUT_CFG
                   UAVIONIX_ADSB_OUT_CONTROL AIRLINK_AUTH),
        do: assert({name, kind.(name)} == {name, :command})

    for name <-
          ~w(VISION_POSITION_DELTA TARGET_RELATIVE TARGET_ABSOLUTE RANGING_BEACON OPEN_DRONE_ID_MESSAGE_PACK),
        do: assert({name, kind.(name)} == {name, :input})
  end

  test "nobody who may not command flies by the channels of a radio", c do
    stranger = udp(c.port)

    sticks =
      MavCodec.encode(%Messages.RadioRcChannels{target_system: 1, target_component: 1, count: 4},
        system: 255,
        component: 190
      )

    say(stranger, sticks)
    say(stranger, mark(255))
    refute sticks in until(c.one, mark(255))
    counted(c, :denied, 1)
  end

  test "R4: a message of an unknown dialect passes, and what may come from a link is the link's filter_in",
       c do
    unknown = &<<0xFD, 3, 0, 0, 1, 255, 190, 0xABCDEF::24-little, 1, 1, &1, 9, 9>>
    stranger = udp(c.port)
    say(stranger, unknown.(5))
    say(stranger, mark(255))
    assert unknown.(5) in until(c.one, mark(255))

    :ok = Router.configure(c.gateway, "radio", filter_in: %{allow_messages: ["ADSB_VEHICLE"]})
    say(stranger, unknown.(6))
    say(stranger, mark(254))
    refute unknown.(6) in until(c.one, mark(254))
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

  defp frame(id), do: %{MavCodec.Frame.from_bytes(heartbeat(1), nil) | id: id}
end
