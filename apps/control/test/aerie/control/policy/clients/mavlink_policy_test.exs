defmodule Aerie.Control.Policy.Clients.MavlinkPolicyTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Base.Principal
  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy
  alias MavRouter.{Link, Router}
  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Clients.MavlinkPolicy
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Control.Policy.Audit.Verify
  alias Aerie.Control.Policy.Mavlink.Writing.Aboard
  alias Aerie.Control.Policy.Clients.Trial
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @patience Aerie.Patience.ms()
  @moduletag :tmp_dir
  @moduletag capture_log: true
  @flights Path.expand("../../../../../../vehicle/test/fixtures", __DIR__)

  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.02, 47.0], [8.02, 47.02], [8.0, 47.02]]]}}
  """

  # A vehicle on a link, and three clients: one of an operator, one of a viewer, one that nobody said anything about.
  setup %{tmp_dir: dir} do
    file = Path.join(dir, "fence.geojson")
    File.write!(file, @fence)

    section = %{
      geofence_file: file,
      max_altitude: 120,
      clients: [%{id: "operator", role: :operator}, %{id: "viewer", role: :viewer}]
    }

    {:ok, policy} = Policy.compile(section)

    gateway =
      start_parts(%{mavlink: %{system_id: 245, component_id: 191}},
        options: [policy: MavlinkPolicy, tables: [Holders.table(), ClientHistory.table()]]
      )

    start_supervised!({Policy.Store, gateway: gateway, policy: policy})
    start_supervised!({Audit, gateway: gateway, dir: Path.join(dir, "audit"), max_bytes: 1_048_576})
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    vehicle = udp(port)
    say(vehicle, heartbeat(1))
    eventually(fn -> Router.route(gateway, {"main", 1}) end)
    known(gateway, %{})
    {:ok, gateway: gateway, vehicle: vehicle, section: section, audit: Path.join(dir, "audit")}
  end

  defp known(gateway, changes) do
    groups = %{
      position: %{lat: 47.001, lon: 8.001, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0},
      home: %{lat: 47.001, lon: 8.001, alt_msl: 500.0},
      mode: %{mode: "GUIDED", armed: true, in_air: true},
      mission: %{seq: 4}
    }

    # A position counts for ten seconds, and a busy machine may need longer.
    at = System.os_time(:microsecond) + 600_000_000

    Store.put_vehicle(gateway, {"main", 1}, %Aerie.Vehicle.Snapshot{
      id: "VID-001",
      key: {"main", 1},
      network: "main",
      system_id: 1,
      component: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      groups:
        Map.new(Map.merge(groups, changes), fn {group, data} ->
          {group, %{at: at, time_boot_ms: nil, data: data}}
        end)
    })
  end

  defp client(gateway, id) do
    {:ok, ^id} = MavRouter.Client.add(gateway, %{url: "udpin:127.0.0.1:0", id: id})
    udp(Link.snapshot(gateway, id).port)
  end

  defp udp(port) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    socket
  end

  defp say(socket, %_module{} = message),
    do: say(socket, MavCodec.encode(message, system: 255, component: 190))

  defp say(socket, bytes), do: :ok = :gen_udp.send(socket, bytes)

  # Messages until one that passes whatever the policy is; what is refused is not among them.
  defp until_mark(socket, mark, before \\ []) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)

    case bytes |> Frame.from_bytes(nil) |> MavCodec.decode() do
      {:ok, %M.AdsbVehicle{icao_address: ^mark}} -> Enum.reverse(before)
      {:ok, message} -> until_mark(socket, mark, [message | before])
    end
  end

  # A viewer's mark would not pass: what it sent has been read before somebody else's goes out.
  defp reached_of_viewer(c, id, n) do
    eventually(fn -> Link.snapshot(c.gateway, id).counters.frames_in >= n end)
    reached(client(c.gateway, "marker"), c)
  end

  defp reached(socket, c) do
    mark = System.unique_integer([:positive])
    say(socket, %M.AdsbVehicle{icao_address: mark})
    c.vehicle |> until_mark(mark) |> Enum.reject(&match?(%M.Heartbeat{}, &1))
  end

  # The next acknowledgement, and the texts before it.
  defp acknowledged(socket, texts \\ "") do
    case answers(socket, 1) do
      [%M.Statustext{text: text}] -> acknowledged(socket, texts <> text)
      [%M.CommandAck{} = ack] -> {ack, texts}
    end
  end

  defp answers(socket, n) do
    for _message <- 1..n do
      {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
      frame = Frame.from_bytes(bytes, nil)
      assert {frame.system, frame.component} == {1, 1}
      {:ok, message} = MavCodec.decode(frame)
      message
    end
  end

  defp goto(lat, altitude),
    do: %M.CommandInt{
      target_system: 1,
      target_component: 1,
      command: MavCmd.value(:MAV_CMD_DO_REPOSITION),
      frame: 6,
      x: round(lat * 1.0e7),
      y: 80_010_000,
      z: altitude
    }

  defp long(name, params \\ []),
    do:
      struct!(
        %M.CommandLong{target_system: 1, target_component: 1, command: MavCmd.value(:"MAV_CMD_#{name}")},
        params
      )

  # S3: nothing that a sender who may nothing does takes away what others need.
  test "a viewer's items to made-up systems, by many endpoints, leave everything to operators", c do
    viewer = Policy.Roles.principal(:client, "viewer", :viewer)
    operator = Policy.Roles.principal(:client, "operator", :operator)
    rows = fn -> :ets.info(Store.table!(c.gateway, :client_history), :size) end

    for n <- 1..40, system <- 2..250//8 do
      sender = %{endpoint: {"viewer", n}, owner: "viewer", peer: nil, principal: viewer}
      assert {:refuse, _answers, _instead} = decided(c, sender, {"main", system}, item(system, 0))
    end

    before = rows.()
    # Notices of refusals, not one for each system.
    assert before < 10

    for system <- 2..250 do
      sender = %{endpoint: {"operator", system}, owner: "operator", peer: nil, principal: operator}
      assert {:refuse, _answers, _instead} = decided(c, sender, {"main", system}, item(system, 0))
    end

    assert rows.() - before < 10

    sender = %{endpoint: {"operator", 1}, owner: "operator", peer: nil, principal: operator}
    for seq <- 0..2, do: assert(decided(c, sender, {"main", 1}, item(1, seq)) == :forward)
    assert decided(c, sender, {"main", 1}, goto(47.002, 30.0)) == :forward
  end

  test "a viewer's refused commands leave an admin's arming in the audit log, and are counted", c do
    admin = %{
      endpoint: {"a", 1},
      owner: "a",
      peer: nil,
      principal: Policy.Roles.principal(:client, "admin", :admin)
    }

    eve = %{
      endpoint: {"v", 1},
      owner: "v",
      peer: nil,
      principal: Policy.Roles.principal(:client, "eve", :viewer)
    }

    assert decided(c, admin, {"main", 1}, arm()) == :forward

    for n <- 1..3_000, system = rem(n, 250) + 1 do
      message = %M.CommandLong{target_system: system, target_component: 1, command: n}
      assert {:refuse, _answers, _instead} = decided(c, eve, {"main", system}, message)
    end

    assert {:ok, %{missed: 0}} = Audit.status(c.gateway)
    {:ok, %{records: records}} = Audit.Reader.page(c.audit, %{limit: 1000})
    assert Enum.any?(records, &match?(%{"source" => "admin", "command" => "arm", "decision" => "allow"}, &1))
    assert length(for %{"source" => "eve"} = record <- records, do: record) <= 4

    late = System.monotonic_time(:microsecond) + 120_000_000
    counts = for %{"source" => "eve", "count" => n} <- Audit.Refusals.due(c.gateway, late), do: n
    assert Enum.sum(counts) > 2_900
  end

  defp arm, do: %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 1.0}

  defp decided(c, sender, key, message, options \\ []) do
    frame =
      message
      |> MavCodec.encode([system: 255, component: 190] ++ options)
      |> IO.iodata_to_binary()
      |> Frame.from_bytes(nil)

    frame = %{frame | crc_extra: MavCodec.Dialects.All.crc_extra(frame.id)}
    MavlinkPolicy.decide(c.gateway, sender, key, frame)
  end

  defp item(system, seq),
    do: %M.MissionItemInt{
      target_system: system,
      target_component: 1,
      seq: seq,
      frame: 6,
      command: MavCmd.value(:MAV_CMD_NAV_WAYPOINT),
      autocontinue: 1,
      x: 470_010_000,
      y: 80_010_000,
      z: 20.0
    }

  test "fence and altitude hold for a ground station's commands, and it gets the reason", c do
    gcs = client(c.gateway, "operator")
    say(gcs, goto(47.01, 50.0))
    say(gcs, goto(47.03, 50.0))
    say(gcs, goto(47.01, 150.0))
    assert [%M.CommandInt{x: 470_100_000}] = reached(gcs, c)

    assert [
             %M.CommandAck{command: 192, result: 2, target_system: 255},
             %M.Statustext{} = first,
             %M.Statustext{}
           ] = answers(gcs, 3)

    assert first.text == "refused: the target 47.030000, 8.001000 is 1112 m "
    assert [%M.CommandAck{command: 192, result: 2}, %M.Statustext{} = high | _] = answers(gcs, 3)
    assert high.text =~ "refused: the target is 150"
    assert Link.snapshot(c.gateway, "operator").counters.denied == 2

    for {counter, n} <- [
          {{:policy, :allow, nil}, 1},
          {{:policy, :deny, :geofence}, 1},
          {{:policy, :deny, :altitude}, 1}
        ],
        do: assert(Store.counter(c.gateway, counter) == n)
  end

  defp texts(answers) do
    for bytes <- answers,
        {:ok, %M.Statustext{text: text}} <- [
          bytes |> IO.iodata_to_binary() |> Frame.from_bytes(nil) |> MavCodec.decode()
        ],
        into: "",
        do: text
  end

  test "every refused thing has its own text at once, and names what was sent; the same one is not repeated",
       c do
    operator = Policy.Roles.principal(:client, "olga", :operator)
    sender = %{endpoint: {"olga", 1}, owner: "olga", peer: nil, principal: operator}

    refused = fn message ->
      {:refuse, answers, _instead} = decided(c, sender, {"main", 1}, message)
      texts(answers)
    end

    to = [target_system: 1, target_component: 1]
    item = fn seq, name -> %{item(1, seq) | command: MavCmd.value(:"MAV_CMD_#{name}")} end

    ftp = fn operation, path ->
      <<0::16, 0, operation, 0::64, path::binary, 0::size((239 - byte_size(path)) * 8)>>
    end

    lacks = "; olga is operator, which does not include it"
    setup = " needs the permission maintain (it changes how the vehicle is set up)" <> lacks
    guard = " needs the permission protection (it changes what protects the vehicle)" <> lacks

    for {message, text} <- [
          {struct!(%M.ParamSet{param_id: "WPNAV_SPEED", param_type: 9}, to), "setting WPNAV_SPEED" <> setup},
          {struct!(%M.ParamSet{param_id: "FENCE_ENABLE", param_type: 9}, to),
           "setting FENCE_ENABLE" <> setup},
          {struct!(%M.SerialControl{}, to), "SERIAL_CONTROL" <> setup},
          {long("SCRIPTING"), "SCRIPTING" <> setup},
          {long("DO_SET_SYS_CMP_ID"), "DO_SET_SYS_CMP_ID" <> setup},
          {long("DO_AUX_FUNCTION", param1: 250.0),
           "DO_AUX_FUNCTION 250 needs the permission terminate (it may end"},
          {item.(3, "SCRIPTING"), "mission item 3 (SCRIPTING)" <> setup},
          {item.(4, "SCRIPTING"), "mission item 4 (SCRIPTING)" <> setup},
          {item.(4, "INJECT_FAILURE"), "mission item 4 (INJECT_FAILURE)" <> guard},
          {struct!(%M.MissionClearAll{mission_type: 1}, to), "removing the fence" <> guard},
          {struct!(%M.MissionCount{mission_type: 1}, to), "removing the fence" <> guard},
          {struct!(%M.LogErase{}, to), "erasing the logs needs the permission maintain or pilot ("},
          {struct!(%M.FileTransferProtocol{payload: ftp.(8, "/fs/a.txt")}, to),
           "changing the file /fs/a.txt" <> setup},
          {long("DO_SET_MODE") |> Map.put(:command, 43_999),
           "the gateway does not know the command 43999 (MAV_CMD)"}
        ] do
      got = refused.(message)
      assert got =~ "refused: " <> String.slice(text, 0, 150) or got == "", inspect({got, text})
      refute got =~ ~r/mav_cmd_|raw needs|_upload needs/
      # Two messages that mean the same have the same text.
      assert got != "" or match?(%M.MissionCount{}, message)
      for _again <- 1..3, do: assert(refused.(message) == "")
    end
  end

  test "T: an operator's listing with times goes to the vehicle, and an operation without a definition is unknown",
       c do
    operator = Policy.Roles.principal(:client, "olga", :operator)
    sender = %{endpoint: {"olga", 1}, owner: "olga", peer: nil, principal: operator}

    ask = fn operation ->
      payload = <<9::16-little, 1, operation, 1, 0, 0, 0, 0::32, "/", 0::size(238 * 8)>>
      message = %M.FileTransferProtocol{target_system: 1, target_component: 1, payload: payload}
      decided(c, sender, {"main", 1}, message)
    end

    for operation <- [3, 16], do: assert(ask.(operation) == :forward)

    for {operation, error} <- [{17, 7}, {100, 7}, {8, 9}] do
      assert {:refuse, [nak | _texts], nil} = ask.(operation)

      {:ok, %M.FileTransferProtocol{payload: payload}} =
        nak |> IO.iodata_to_binary() |> Frame.from_bytes(nil) |> MavCodec.decode()

      assert <<10::16-little, 1, 129, 1, ^operation, 0, 0, 0::32, ^error, _::binary>> = payload
    end
  end

  test "roles: a viewer reaches no vehicle with anything, an operator maintains nothing", c do
    viewer = client(c.gateway, "viewer")
    say(viewer, long("COMPONENT_ARM_DISARM", param1: 1.0))
    say(viewer, %M.SetMode{target_system: 1, base_mode: 1, custom_mode: 6})
    say(viewer, %M.RcChannelsOverride{target_system: 1, chan3_raw: 1900})
    say(viewer, %M.ParamRequestList{target_system: 1, target_component: 1})
    say(viewer, %M.MissionSetCurrent{target_system: 1, target_component: 1, seq: 9})
    say(viewer, %M.FileTransferProtocol{target_system: 1, target_component: 1})
    say(viewer, %M.GpsInput{lat: 7})
    say(viewer, %M.SystemTime{time_unix_usec: 7})
    say(viewer, heartbeat(255, type: 6, autopilot: 8, component: 190))
    # The gateway asks for it.
    assert [%M.ParamRequestList{}] = reached_of_viewer(c, "viewer", 9)
    got = answers(viewer, 9)
    assert Enum.any?(got, &match?(%M.CommandAck{command: 400, result: 2}, &1))
    assert Enum.any?(got, &match?(%M.CommandAck{command: 11, result: 2}, &1))
    assert Enum.any?(got, &match?(%M.MissionCurrent{seq: 4}, &1))

    operator = client(c.gateway, "operator")
    say(operator, long("COMPONENT_ARM_DISARM"))
    say(operator, long("COMPONENT_ARM_DISARM", param2: 21_196.0))
    say(operator, %M.MissionCount{target_system: 1, target_component: 1, count: 3})
    # P3: the vehicle is asked for the value that it has.
    say(operator, %M.ParamSet{target_system: 1, target_component: 1, param_id: "RTL_ALT", param_value: 0.0})

    assert [
             %M.CommandLong{param2: +0.0},
             %M.MissionCount{},
             %M.ParamRequestRead{param_id: "RTL_ALT", param_index: -1}
           ] = reached(operator, c)
  end

  test "a viewer's refused write is not a question of the viewer to the vehicle: the gateway asks", c do
    viewer = client(c.gateway, "viewer")
    say(viewer, %M.ParamSet{target_system: 1, target_component: 1, param_id: "RTL_ALT", param_value: 0.0})
    say(viewer, %M.ParamExtSet{target_system: 1, target_component: 1, param_id: "CAM_MODE"})
    eventually(fn -> Link.snapshot(c.gateway, "viewer").counters.frames_in >= 2 end)
    mark = MavCodec.encode(%M.AdsbVehicle{icao_address: 7}, system: 254, component: 190)
    say(client(c.gateway, "marker"), mark)
    assert [{245, M.ParamRequestRead}] = until_bytes(c.vehicle, mark)
  end

  test "V1: a refusal and what takes the place of a refused frame are in the version of the frame", c do
    operator = Policy.Roles.principal(:client, "operator", :operator)
    sender = %{endpoint: {"operator", 1}, owner: "operator", peer: nil, principal: operator}
    set = %M.ParamSet{target_system: 1, target_component: 1, param_id: "RTL_ALT"}

    for version <- [1, 2] do
      {:refuse, answers, instead} = decided(c, sender, {"main", 1}, set, version: version)
      assert version == 2 or answers != []
      for bytes <- answers, do: assert(%{version: ^version} = Frame.from_bytes(bytes, nil))
      assert %{version: ^version} = instead
    end
  end

  # Who sent what, up to these bytes.
  defp until_bytes(socket, last, before \\ []) do
    {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
    frame = Frame.from_bytes(bytes, nil)

    if bytes == last,
      do: Enum.reverse(before),
      else:
        until_bytes(
          socket,
          last,
          before ++
            for(
              {:ok, %module{}} <- [MavCodec.decode(frame)],
              module != M.Heartbeat,
              do: {frame.system, module}
            )
        )
  end

  test "who is in charge (X15): a client asks for control, and is answered by the gateway", c do
    one = client(c.gateway, "operator")
    other = client(c.gateway, "someone")
    request = &long("REQUEST_OPERATOR_CONTROL", param1: &1, param2: &2)
    arm = long("COMPONENT_ARM_DISARM", param1: 1.0)
    say(one, request.(1.0, 0.0))
    assert {%M.CommandAck{command: 32_100, result: 0, target_system: 255}, ""} = acknowledged(one)
    assert %{holder: "operator 127.0.0.1:" <> _, via: "mavlink"} = Holders.of(c.gateway, {"main", 1})
    assert Link.snapshot(c.gateway, "operator").counters.denied == 0
    say(other, request.(1.0, 0.0))
    say(other, arm)
    assert {%M.CommandAck{command: 32_100, result: 2}, _texts} = acknowledged(other)
    assert {%M.CommandAck{command: 400, result: 2}, texts} = acknowledged(other)
    assert texts =~ ~r/refused: operator 127.0.0.1:\d+ is in charge of the vehicle \(since/

    # It may be taken over from now on.
    say(one, request.(1.0, 1.0))
    assert {%M.CommandAck{result: 0}, _texts} = acknowledged(one)
    say(other, request.(1.0, 0.0))
    assert {%M.CommandAck{command: 32_100, result: 0}, _texts} = acknowledged(other)
    say(other, arm)
    # What brings it down is free.
    say(one, arm)
    say(one, long("NAV_LAND"))
    assert {%M.CommandAck{command: 400, result: 2}, _texts} = acknowledged(one)
    # Each client has a process of its own, so each has to be waited for.
    eventually(fn -> Link.snapshot(c.gateway, "operator").counters.frames_in >= 4 end)
    reached = reached(other, c)
    assert Enum.sort(for %M.CommandLong{command: command} <- reached, do: command) == [21, 400]

    # A vehicle that keeps it itself is asked by the client.
    known(c.gateway, %{operator: %{system: 0, takeover_allowed: false}})
    say(other, request.(0.0, 0.0))
    assert [%M.CommandLong{command: 32_100}] = reached(other, c)
    assert Holders.of(c.gateway, {"main", 1}) == nil
  end

  test "programs of one client are not each other: one is in charge, and nobody is once it is gone", c do
    one = client(c.gateway, "operator")
    other = udp(Link.snapshot(c.gateway, "operator").port)
    take = long("REQUEST_OPERATOR_CONTROL", param1: 1.0)
    arm = long("COMPONENT_ARM_DISARM", param1: 1.0)
    say(one, take)
    assert [%M.CommandAck{result: 0}] = answers(one, 1)
    for message <- [arm, long("REQUEST_OPERATOR_CONTROL"), %M.GpsInput{lat: 7}], do: say(other, message)
    assert [%M.CommandAck{command: 400, result: 2} | _] = answers(other, 3)
    assert [] = reached(one, c)

    {"operator", peer} = Holders.of(c.gateway, {"main", 1}).endpoint
    MavRouter.Endpoints.remove(MavRouter.Tables.of(c.gateway), {"operator", peer})
    say(other, take)

    assert eventually(fn ->
             match?(
               %{endpoint: {"operator", other}} when other != peer,
               Holders.of(c.gateway, {"main", 1})
             )
           end)
  end

  test "nobody takes charge of a vehicle that was not heard", c do
    one = client(c.gateway, "operator")
    say(one, %{long("REQUEST_OPERATOR_CONTROL", param1: 1.0) | target_system: 77})
    eventually(fn -> Link.snapshot(c.gateway, "operator").counters.denied == 1 end)
    assert Holders.all(c.gateway) == %{}
  end

  test "a client that is not listed is an operator on this machine and a viewer beyond it, and never more",
       c do
    gcs = client(c.gateway, "someone")
    say(gcs, long("COMPONENT_ARM_DISARM", param2: 21_196.0))
    say(gcs, %M.ParamSet{target_system: 1, target_component: 1, param_id: "RTL_ALT"})
    say(gcs, %M.SerialControl{})
    say(gcs, long("COMPONENT_ARM_DISARM", param1: 1.0))
    assert [%M.ParamRequestRead{}, %M.CommandLong{param1: 1.0}] = reached(gcs, c)

    policy = Policy.Store.get(c.gateway)
    path = %{owner: "new", text: "10.0.0.9:5000", key: {"new", 1}, principal: nil, side: :client, auto: false}
    role = &Policy.principal(policy, Map.merge(path, &1)).role
    assert role.(%{commands: true, local: true}) == :operator
    assert role.(%{commands: true, local: false}) == :viewer
    # gcs: allow is a decision for all who reach the link.
    assert role.(%{commands: true, local: false, side: :vehicle}) == :operator
    assert role.(%{commands: true, local: false, auto: true}) == :operator
    # Who may not command by a link is a viewer, whatever is listed for it.
    assert role.(%{owner: "operator", commands: false, local: false, side: :vehicle}) == :viewer
    assert role.(%{owner: "operator", commands: true, local: false}) == :operator
  end

  test "who proved by a key who he is, is that, whatever the client's entry says", c do
    path =
      %{owner: "operator", text: "olga@10.0.0.9:5000", key: {"ws-1", 1}, side: :client, auto: false}
      |> Map.merge(%{commands: true, local: false})

    policy = Policy.Store.get(c.gateway)

    who =
      &Policy.principal(policy, Map.put(path, :principal, struct!(%Principal{kind: :key, name: "olga"}, &1)))

    assert %{kind: :key, name: "olga", role: :viewer, may: []} = who.(role: :viewer, permissions: [:fly])
    assert %{role: :admin} = admin = who.(role: nil)
    assert Principal.may?(admin, :maintain)
    refute Principal.may?(admin, :force_disarm)
    assert Principal.may?(who.(role: :operator, permissions: [:force_disarm]), :force_disarm)

    frame =
      %M.ParamSet{target_system: 1, param_id: "RTL_ALT"}
      |> MavCodec.encode(system: 255)
      |> Frame.from_bytes(nil)

    sender = %{endpoint: {"ws-1", 1}, owner: "ws-1", peer: "10.0.0.9:5000", principal: who.(role: nil)}
    assert MavlinkPolicy.decide(c.gateway, sender, {"main", 1}, frame) == :forward
    operator = %{sender | principal: who.(role: :operator)}
    assert {:refuse, _answers, _instead} = MavlinkPolicy.decide(c.gateway, operator, {"main", 1}, frame)
  end

  test "two connections of one client share its rates", c do
    :ok = Policy.Store.put(c.gateway, Map.put(c.section, :rates, [%{per_minute: 1, burst: 2}]))
    one = client(c.gateway, "operator")
    two = udp(Link.snapshot(c.gateway, "operator").port)
    # Frames of one station by two ways would be taken for duplicates.
    ids = fn system, n -> [system: system, component: 190, seq: n] end

    for {socket, system} <- [{one, 255}, {two, 254}],
        n <- 1..2,
        do: say(socket, MavCodec.encode(goto(47.01, 50.0), ids.(system, n)))

    assert [%M.CommandInt{}, %M.CommandInt{}] = reached(one, c)
  end

  test "a refusal can be answered whatever ids the sender and the vehicle have", c do
    who =
      Policy.principal(Policy.Store.get(c.gateway), %{
        owner: "operator",
        text: nil,
        principal: nil,
        commands: true,
        local: true,
        side: :client,
        auto: false
      })

    sender = %{endpoint: {"operator", 1}, owner: "operator", peer: nil, principal: who}
    write = MavCodec.encode(%M.ParamSet{target_system: 1, param_id: "RTL_ALT"}, system: 255)
    force = &%M.CommandLong{target_system: &1, command: 400, param2: 21_196.0}
    decide = &MavlinkPolicy.decide(c.gateway, sender, {"main", &1}, %{Frame.from_bytes(&2, nil) | system: &3})

    # Long ids.
    assert {:refuse, [_ | _], %Frame{system: 300}} = decide.(300, write, 300)
    long = MavCodec.encode(force.(300), system: 300, sysid32: true)
    assert {:refuse, [ack | _], nil} = decide.(300, long, 300)

    assert {[%Frame{system: 300, target_system: 300}], _parser} =
             MavCodec.Parser.push(MavCodec.Parser.new(sysid32: true), ack)

    # None.
    assert {:refuse, [_ | _], nil} = decide.(1, write, 0)
    # Nobody answers for vehicles that were not heard yet.
    all = MavCodec.encode(force.(0), system: 255)
    assert {:refuse, [], nil} = decide.(0, all, 255)
    control = MavCodec.encode(long("REQUEST_OPERATOR_CONTROL", param1: 1.0), system: 255)
    assert {:refuse, [], nil} = decide.(0, control, 255)
  end

  test "a command for all systems is judged for each vehicle that it would reach", c do
    gcs = client(c.gateway, "operator")
    say(gcs, %{goto(47.03, 50.0) | target_system: 0, target_component: 0})
    say(gcs, %{long("NAV_LAND") | target_system: 0, target_component: 0})
    assert [%M.CommandLong{}] = reached(gcs, c)
    assert [%M.CommandAck{result: 2} | _] = answers(gcs, 1)
  end

  test "mission items outside are refused with MISSION_ACK, set-points with a text every five seconds", c do
    gcs = client(c.gateway, "operator")

    item = %M.MissionItemInt{
      target_system: 1,
      target_component: 1,
      seq: 2,
      frame: 6,
      command: 16,
      x: 470_300_000,
      y: 80_010_000,
      z: 20.0
    }

    say(gcs, item)
    assert [] = reached(gcs, c)
    assert [%M.MissionAck{type: 14}, %M.Statustext{text: text} | _] = answers(gcs, 3)
    assert text =~ "mission item 2"

    setpoint = %M.SetPositionTargetGlobalInt{
      target_system: 1,
      coordinate_frame: 6,
      type_mask: 0b110111111000,
      lat_int: 470_300_000,
      lon_int: 80_010_000,
      alt: 20.0
    }

    begun = System.monotonic_time(:millisecond)
    for _times <- 1..20, do: say(gcs, setpoint)
    assert [] = reached(gcs, c)
    again = div(System.monotonic_time(:millisecond) - begun, 5_000)
    assert [%M.Statustext{}, %M.Statustext{}] = answers(gcs, 2)
    assert Link.snapshot(c.gateway, "operator").counters.denied == 21
    # Nothing more, unless all this took so long: the next thing that it hears is the vehicle.
    say(c.vehicle, heartbeat(1))

    texts =
      fn -> hd(answers(gcs, 1)) end
      |> Stream.repeatedly()
      |> Enum.take_while(&(not match?(%M.Heartbeat{}, &1)))

    assert length(texts) <= 2 * again
    assert Enum.all?(texts, &match?(%M.Statustext{}, &1))

    # PX4's OFFBOARD needs those that pass (X7).
    assert RecentCommands.setpoints_ms(c.gateway, "VID-001") == nil
    say(gcs, %{setpoint | lat_int: 470_050_000, lon_int: 80_050_000})
    assert [%M.SetPositionTargetGlobalInt{}] = reached(gcs, c)
    assert {_since, _until} = Store.recall(c.gateway, {:setpoints, "VID-001"})
  end

  test "a mission whose items are inside and whose way is not is refused at the item where it leaves", c do
    # Both are in the corners of a field whose middle is cut out.
    hole = "[[8.009, 47.009], [8.011, 47.009], [8.011, 47.011], [8.009, 47.011]]"
    File.write!(c.section.geofence_file, String.replace(@fence, "[8.0, 47.02]]]", "[8.0, 47.02]], #{hole}]"))
    :ok = Policy.Store.put(c.gateway, c.section)
    gcs = client(c.gateway, "operator")

    item =
      &%M.MissionItemInt{
        target_system: 1,
        target_component: 1,
        seq: &1,
        frame: 6,
        command: 16,
        x: &2,
        y: &3,
        z: 20.0
      }

    say(gcs, %M.MissionCount{target_system: 1, target_component: 1, count: 3})
    say(gcs, item.(1, 470_010_000, 80_010_000))
    say(gcs, item.(2, 470_010_000, 80_190_000))
    say(gcs, item.(3, 470_190_000, 80_010_000))
    assert [%M.MissionCount{}, %M.MissionItemInt{seq: 1}, %M.MissionItemInt{seq: 2}] = reached(gcs, c)

    assert [
             %M.MissionAck{type: 14},
             %M.Statustext{text: "refused: the straight way to mission item 3" <> _} | _
           ] = answers(gcs, 3)
  end

  test "an upload is judged whole with its jumps, and a mission that is entered by the way there", c do
    # Both are in the corners of a field whose middle is cut out; the way leads round it.
    hole = "[[8.009, 47.009], [8.011, 47.009], [8.011, 47.011], [8.009, 47.011]]"
    File.write!(c.section.geofence_file, String.replace(@fence, "[8.0, 47.02]]]", "[8.0, 47.02]], #{hole}]"))
    :ok = Policy.Store.put(c.gateway, c.section)
    gcs = client(c.gateway, "operator")
    to = %M.MissionItemInt{target_system: 1, target_component: 1, frame: 6, command: 16, z: 20.0}
    at = &%{to | seq: &1, x: &2, y: &3}

    round = [
      at.(0, 0, 0),
      at.(1, 470_010_000, 80_100_000),
      at.(2, 470_100_000, 80_180_000),
      at.(3, 470_190_000, 80_100_000)
    ]

    jump = %{to | seq: 4, frame: 2, command: 177, param1: 1.0, param2: -1.0}
    count = %M.MissionCount{target_system: 1, target_component: 1}
    current = %M.MissionSetCurrent{target_system: 1, target_component: 1}

    # Nobody knows what is aboard.
    say(gcs, %{current | seq: 3})
    assert [%M.MissionCurrent{seq: 4}, %M.Statustext{} = unknown | _] = answers(gcs, 5)
    assert unknown.text =~ "refused: a fence or a limit of height applies to"
    for message <- [%{count | count: 5} | round] ++ [jump], do: say(gcs, message)
    assert [%M.MissionCount{} | taken] = reached(gcs, c)
    assert Enum.map(taken, & &1.seq) == [0, 1, 2, 3]
    assert [%M.MissionAck{type: 14}, %M.Statustext{} = refused] = answers(gcs, 2)
    assert refused.text =~ "refused: the straight way to mission item 4"

    # Without the jump it is whole. From item 1 the vehicle gets to item 3 only through the hole.
    known(c.gateway, %{position: %{lat: 47.001, lon: 8.01, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0}})

    for message <- [%{count | count: 4} | round] ++ [%{current | seq: 1}, %{current | seq: 3}],
        do: say(gcs, message)

    assert [%M.MissionCount{}, _0, _1, _2, _3, %M.MissionSetCurrent{seq: 1}] = reached(gcs, c)
  end

  test "a vehicle of which nothing is known is refused what needs to be known, and a new policy counts at once",
       c do
    Store.put_vehicle(c.gateway, {"main", 1}, %Aerie.Vehicle.Snapshot{
      id: "VID-001",
      key: {"main", 1},
      network: "main",
      system_id: 1,
      component: nil,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      groups: %{}
    })

    gcs = client(c.gateway, "operator")
    say(gcs, goto(47.01, 50.0))
    assert [] = reached(gcs, c)
    assert [%M.CommandAck{result: 2}, %M.Statustext{text: text} | _] = answers(gcs, 3)
    assert text =~ "a fence applies to goto, and the"

    assert {:error, ["policy.geofence_file: " <> _]} =
             Policy.Store.put(c.gateway, %{geofence_file: "/no/such/file"})

    say(gcs, goto(47.01, 50.0))
    assert [] = reached(gcs, c)
    assert :ok = Policy.Store.put(c.gateway, %{c.section | geofence_file: nil})
    say(gcs, goto(47.01, 50.0))
    assert [%M.CommandInt{}] = reached(gcs, c)
  end

  test "decisions are in the audit log; while it cannot be written, what must be recorded is refused", c do
    gcs = client(c.gateway, "operator")
    begun = System.monotonic_time(:millisecond)
    say(gcs, goto(47.01, 50.0))
    for _times <- 1..3, do: say(gcs, goto(47.03, 50.0))
    reached(gcs, c)
    again = div(System.monotonic_time(:millisecond) - begun, 5_000)
    {:ok, _status} = Audit.status(c.gateway)

    records =
      c.audit
      |> Path.join("*.jsonl")
      |> Path.wildcard()
      |> Enum.flat_map(&File.stream!/1)
      |> Enum.map(&JSON.decode!/1)

    # A refusal is recorded once in five seconds.
    assert [%{"type" => "opened"}, allowed, refused | repeated] = records
    assert length(repeated) <= again

    assert %{
             "decision" => "allow",
             "command" => "goto",
             "source" => "operator",
             "vehicle" => "VID-001",
             "system" => 255
           } = allowed

    assert %{"decision" => "deny", "rule" => "geofence", "message" => "COMMAND_INT", "reason" => reason} =
             refused

    assert reason =~ "1112 m outside"
    assert {:ok, %{problems: []}} = Verify.folder(c.audit)

    pid = Names.whereis(c.gateway, :audit)
    full = fn -> :file.open(~c"/dev/full", [:read, :write, :raw, :binary]) |> elem(1) end

    in_log = [
      Access.key!(:log),
      Access.key!(:store),
      Access.key!(:segments),
      Access.all(),
      Access.key!(:file)
    ]

    :sys.replace_state(pid, &put_in(&1, in_log, full.()))
    assert {:error, _full} = Audit.append(c.gateway, %{"type" => "decision"})
    assert Store.counter(c.gateway, {:audit, :missed}) == 1
    say(gcs, goto(47.01, 51.0))
    say(gcs, long("NAV_LAND"))
    assert [%M.CommandLong{}] = reached(gcs, c)
  end

  test "a flood is refused, but never what brings the vehicle down", c do
    :ok = Policy.Store.put(c.gateway, Map.put(c.section, :rates, [%{per_minute: 1, burst: 5}]))
    gcs = client(c.gateway, "operator")
    for _times <- 1..20, do: say(gcs, goto(47.01, 50.0))
    for _times <- 1..20, do: say(gcs, long("NAV_LAND"))
    got = reached(gcs, c)
    assert Enum.count(got, &match?(%M.CommandInt{}, &1)) in 5..6
    assert Enum.count(got, &match?(%M.CommandLong{}, &1)) == 20
  end

  test "a trial of the same policy decides the same about every frame of two flights",
       %{gateway: gateway, section: section} do
    {:ok, policy} = Policy.compile(section)
    snapshot = Store.vehicle(gateway, {"main", 1})

    frames =
      for name <- ~w(px4_refusals_tx arducopter_flight_tx),
          frame <- Aerie.Flight.parse(File.read!(Path.join(@flights, name <> ".tlog"))),
          MavCodec.Meaning.Messages.order?(frame.id),
          do: MavCodec.Frame.Splitter.checked(frame)

    for {role, n} <- Enum.with_index(~w(viewer operator admin)a), permissions <- [[], [:force_disarm]] do
      source = Policy.Roles.principal(:client, "#{role}-#{length(permissions)}", role, permissions)
      sender = %{endpoint: {"c", {n, permissions}}, owner: "c", peer: nil, principal: source}
      # A vehicle of its own: an upload that one of them leaves unfinished counts for the next.
      key = {"main", 100 + 10 * n + length(permissions)}
      snapshot = %{snapshot | key: key, id: "VID-#{elem(key, 1)}"}
      Store.put_vehicle(gateway, key, snapshot)
      # A trial knows of no plan that was aboard before.
      Aboard.sent(gateway, key, 0, [])

      asked = %{
        snapshot: snapshot,
        at: System.os_time(:microsecond),
        source: source,
        sender: "c",
        via: "mavlink"
      }

      {rules, _trial} =
        Enum.map_reduce(frames, Trial.new(policy), fn frame, trial ->
          {:ok, message} = MavCodec.decode(frame)
          {judged, trial} = Trial.message(trial, message, asked)
          # Nor of one that was written meanwhile, which a gateway reads again.
          true = Aboard.read(gateway, key, 1, [], System.monotonic_time(:microsecond))
          live = MavlinkPolicy.decide(gateway, sender, key, frame)

          case judged do
            :free -> assert live == :forward or role == :viewer
            %{decision: :allow} -> assert not match?({:refuse, _, _}, live), inspect(message)
            %{decision: {:deny, _rule, _reason}} -> assert match?({:refuse, _, _}, live), inspect(message)
          end

          {with(%{decision: {:deny, rule, _reason}} <- judged, do: rule, else: (_allowed -> :allow)), trial}
        end)

      # Both outcomes occur, so that the comparison means something.
      if role != :viewer, do: assert([:allow, :role] -- rules == [])
    end
  end
end
