defmodule Aerie.Control.Policy.MavlinkTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire, only: [decoded: 1]

  alias Aerie.Control.Policy.{Intent, Mavlink}
  alias Aerie.Control.Policy.Mavlink.Refusal
  alias MavCodec.Meaning.Messages
  alias MavCodec.Dialects.All
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  @copter %{autopilot: :ardupilot, vehicle_type: "copter"}
  @px4 %{autopilot: :px4, vehicle_type: "copter"}

  defp cmd(name), do: MavCmd.value(:"MAV_CMD_#{name}") || flunk(name)
  defp long(name, params \\ []), do: struct!(%M.CommandLong{command: cmd(name)}, params)
  defp int(name, params), do: struct!(%M.CommandInt{command: cmd(name)}, params)
  defp facts(message, vehicle \\ @copter), do: Mavlink.facts(message, vehicle)

  defp place(lat, lon, height), do: %{lat: lat, lon: lon, height: height}

  test "commands, as LONG and INT, mean what the table's commands mean" do
    for {message, vehicle, type, permission, path} <- [
          {long("COMPONENT_ARM_DISARM", param1: 1.0), @copter, "arm", :arm, :none},
          {long("COMPONENT_ARM_DISARM", param1: 1.0, param2: 2989.0), @copter, "arm", :maintain, :none},
          {long("COMPONENT_ARM_DISARM"), @copter, "disarm", :arm, :none},
          {long("COMPONENT_ARM_DISARM", param2: 21_196.0), @copter, "force_disarm", :force_disarm, :none},
          {long("NAV_TAKEOFF", param7: 20.0), @copter, "takeoff", :fly,
           {:to, [place(nil, nil, {:home, 20.0})]}},
          # PX4 flies to 0, 0 if it is told to.
          {long("NAV_TAKEOFF", param7: 520.0), @px4, "takeoff", :fly,
           {:to, [place(0.0, 0.0, {:msl, 520.0})]}},
          {long("NAV_TAKEOFF", param5: :nan, param6: :nan, param7: 520.0), @px4, "takeoff", :fly,
           {:to, [place(nil, nil, {:msl, 520.0})]}},
          {long("NAV_TAKEOFF", param5: :nan, param6: :nan, param7: :nan), @px4, "takeoff", :fly,
           {:to, [place(nil, nil, :same)]}},
          {int("DO_REPOSITION", frame: 6, x: 471_000_000, y: -81_000_000, z: 30.0), @copter, "goto", :fly,
           {:to, [place(47.1, -8.1, {:home, 30.0})]}},
          {int("DO_REPOSITION", frame: 5, x: 0x7FFFFFFF, y: 0x7FFFFFFF, z: 530.0), @copter, "goto", :fly,
           {:to, [place(nil, nil, {:msl, 530.0})]}},
          {int("DO_REPOSITION", frame: 11, x: 1, y: 1, z: 5.0), @copter, "goto", :fly,
           {:to, [place(1.0e-7, 1.0e-7, {:terrain, 5.0})]}},
          {long("DO_REPOSITION", param5: 47.0, param6: 8.0, param7: :nan), @px4, "goto", :fly,
           {:to, [place(47.0, 8.0, :same)]}},
          {long("NAV_WAYPOINT", param5: 47.0, param6: 8.0, param7: 10.0), @copter, "mav_cmd_16", :fly,
           {:to, [place(47.0, 8.0, {:home, 10.0})]}},
          {long("DO_ORBIT", param1: -50.0, param5: 47.0, param6: 8.0, param7: 10.0), @copter, "orbit", :fly,
           {:around, place(47.0, 8.0, {:home, 10.0}), -50.0}},
          {long("DO_CHANGE_ALTITUDE", param1: 40.0, param2: 3.0), @copter, "set_altitude", :fly,
           {:to, [place(nil, nil, {:home, 40.0})]}},
          {long("DO_SET_HOME", param1: 1.0), @copter, "set_home", :fly, {:at, [place(nil, nil, :same)]}},
          {long("DO_SET_HOME", param5: 47.0, param6: 8.0, param7: 500.0), @copter, "set_home", :fly,
           {:at, [place(47.0, 8.0, {:msl, 500.0})]}},
          {long("NAV_RETURN_TO_LAUNCH"), @copter, "rtl", :fly, :none},
          {long("NAV_LAND"), @copter, "land", :fly, :none},
          {long("DO_PAUSE_CONTINUE"), @copter, "mission_pause", :mission, :none},
          {long("DO_PAUSE_CONTINUE", param1: 1.0), @copter, "resume", :mission, :none},
          {long("OVERRIDE_GOTO"), @copter, "hold", :fly, :none},
          {long("REQUEST_OPERATOR_CONTROL", param1: 1.0), @copter, "take_control", :fly, :none},
          {long("REQUEST_OPERATOR_CONTROL"), @copter, "release_control", :fly, :none},
          {long("DO_FLIGHTTERMINATION", param1: 1.0), @copter, "terminate", :terminate, :none},
          {long("PREFLIGHT_REBOOT_SHUTDOWN", param1: 1.0), @copter, "reboot", :maintain, :none},
          {%M.CommandLong{command: 31_010}, @copter, "mav_cmd_31010", :maintain, :none},
          {long("DO_FOLLOW"), @copter, "mav_cmd_32", :fly, :anywhere}
        ] do
      assert %Intent{type: ^type, permission: ^permission, path: found} =
               message |> decoded() |> facts(vehicle)

      assert near?(found, path), inspect({type, found, path})
    end

    assert facts(long("NAV_LAND")).ends_flight?
    assert facts(long("DO_PARACHUTE", param1: 2.0)).ends_flight?
    refute facts(long("DO_PARACHUTE", param1: 1.0)).ends_flight?
  end

  # Floats on the wire have seven digits.
  defp near?(a, b) when is_number(a) and is_number(b), do: abs(a - b) < 1.0e-5
  defp near?(a, b) when is_tuple(a) and is_tuple(b), do: near?(Tuple.to_list(a), Tuple.to_list(b))
  defp near?(%{} = a, %{} = b), do: near?(Enum.sort(a), Enum.sort(b))
  defp near?([a | more], [b | others]), do: near?(a, b) and near?(more, others)
  defp near?(a, b), do: a == b

  test "modes are known by their names" do
    assert facts(%M.SetMode{base_mode: 1, custom_mode: 4}).mode == "GUIDED"
    assert facts(long("DO_SET_MODE", param1: 1.0, param2: 6.0)).mode == "RTL"
    assert facts(long("DO_SET_MODE", param1: 1.0, param2: 4.0, param3: 5.0), @px4).mode == "AUTO_RTL"
    assert facts(long("DO_SET_STANDARD_MODE", param1: 2.0)).standard_mode == "orbit"
  end

  test "uploads: items are judged by their places, fences by where they let the vehicle go" do
    item = fn fields ->
      struct!(
        %M.MissionItemInt{frame: 6, command: 16, seq: 3, x: 470_000_000, y: 80_000_000, z: 50.0},
        fields
      )
    end

    for {message, type, path} <- [
          {%M.MissionCount{count: 4}, "mission_upload", :none},
          {%M.MissionCount{count: 4, mission_type: 1}, "fence_upload", :none},
          {%M.MissionClearAll{mission_type: 2}, "rally_upload", :none},
          {item.([]), "mission_upload", {:at, [place(47.0, 8.0, {:home, 50.0})]}},
          {item.(seq: 0), "mission_upload", :none},
          {item.(command: 20), "mission_upload", :none},
          {item.(command: 178), "mission_upload", :none},
          {item.(current: 2), "goto", {:to, [place(47.0, 8.0, {:home, 50.0})]}},
          {item.(current: 3), "set_altitude", {:to, [place(nil, nil, {:home, 50.0})]}},
          {item.(mission_type: 1, command: 5001), "fence_upload", {:at, [place(47.0, 8.0, :same)]}},
          {item.(mission_type: 1, command: 5002), "fence_upload", :none},
          {item.(mission_type: 2, command: 5100), "rally_upload", {:at, [place(47.0, 8.0, {:home, 50.0})]}},
          {%M.MissionItem{frame: 3, command: 16, seq: 1, x: 47.0, y: 8.0, z: 5.0}, "mission_upload",
           {:at, [place(47.0, 8.0, {:home, 5.0})]}},
          {%M.FencePoint{idx: 1, lat: 47.0, lng: 8.0}, "fence_upload", {:at, [place(47.0, 8.0, :same)]}},
          {%M.RallyPoint{idx: 1, lat: 470_000_000, lng: 80_000_000, alt: 30}, "rally_upload",
           {:at, [place(47.0, 8.0, {:home, 30})]}}
        ] do
      assert %Intent{type: ^type, path: ^path} = message |> decoded() |> facts()
    end

    assert facts(item.(seq: 7), @px4).what == "mission item 7"
    # A take-off says where only if it is elsewhere.
    assert {:at, [%{lat: nil, lon: nil, height: {:home, 50.0}}]} = facts(item.(command: 22, x: 0, y: 0)).path
    # Only ArduPilot keeps item 0 for home.
    assert {:at, _places} = facts(item.(seq: 0), @px4).path
  end

  test "an upload is judged with the ways from item to item, also when items come again" do
    item = fn seq, lat ->
      %M.MissionItemInt{frame: 6, command: 16, seq: seq, x: lat * 10_000_000, y: 0, z: 5.0}
    end

    step = fn message, {paths, last} ->
      {facts, last} = Mavlink.Upload.next(last, message, facts(message, @px4))
      {paths ++ [facts.path], last}
    end

    at = fn lat -> place(lat / 1, 0.0, {:home, 5.0}) end
    jump = %M.MissionItemInt{command: 177, seq: 3}

    messages = [
      %M.MissionCount{count: 4},
      item.(1, 47),
      item.(2, 48),
      item.(2, 48),
      jump,
      item.(4, 49),
      item.(1, 50),
      item.(2, 51)
    ]

    {paths, last} = Enum.reduce(messages, {[], nil}, step)

    assert paths == [
             :none,
             {:at, [at.(47)]},
             {:from, at.(47), at.(48)},
             {:from, at.(47), at.(48)},
             :none,
             {:from, at.(48), at.(49)},
             {:at, [at.(50)]},
             {:from, at.(50), at.(51)}
           ]

    assert {_facts, nil} = Mavlink.Upload.next(last, %M.MissionCount{}, facts(%M.MissionCount{}))
  end

  test "set-points lead where their masks say" do
    global =
      &%M.SetPositionTargetGlobalInt{
        coordinate_frame: 6,
        type_mask: &1,
        lat_int: 470_000_000,
        lon_int: 80_000_000,
        alt: 9.0,
        vx: 3.0
      }

    local =
      &%M.SetPositionTargetLocalNed{
        coordinate_frame: &1,
        type_mask: &2,
        x: 1.0,
        y: 2.0,
        z: -3.0,
        vx: 4.0,
        vy: 5.0,
        vz: -6.0
      }

    drift = &{:drift, Intent.drift(&1, &2, acceleration: {0, 0, 0})}

    for {message, type, path} <- [
          {global.(0b110111111000), "setpoint_position", {:to, [place(47.0, 8.0, {:home, 9.0})]}},
          {global.(0b110111000111), "setpoint_velocity", drift.(:north, {3.0, 0.0, 0.0})},
          {global.(0b110111111111), "setpoint_attitude", :none},
          {local.(1, 0b110111111000), "setpoint_local", {:offset, {1.0, 2.0, -3.0}}},
          {local.(7, 0b110111111000), "setpoint_local", {:shift, :north, {1.0, 2.0, -3.0}}},
          {local.(9, 0b110111111000), "setpoint_local", {:shift, :body, {1.0, 2.0, -3.0}}},
          {local.(8, 0b110111000111), "setpoint_velocity", drift.(:body, {4.0, 5.0, -6.0})},
          {%M.SetAttitudeTarget{}, "setpoint_attitude", :anywhere},
          {%M.RcChannelsOverride{}, "rc_override", :none},
          {%M.RadioRcChannels{}, "rc_override", :none},
          {%M.CubepilotRawRc{}, "rc_override", :none},
          {%M.ManualControl{}, "manual_control", :none}
        ] do
      assert %Intent{type: ^type, permission: :manual, path: ^path} = message |> decoded() |> facts()
    end
  end

  test "files: reading is free, writing needs more" do
    ftp = &%M.FileTransferProtocol{payload: <<7::16-little, 0, &1, 0::size(247 * 8)>>}
    # 16 lists a folder with times: MAVProxy's first question.
    for operation <- [0, 1, 2, 3, 4, 5, 14, 15, 16, 128, 129], do: assert(facts(ftp.(operation)) == :free)

    for operation <- 6..13,
        do: assert(%Intent{type: "write_file", permission: :maintain} = facts(ftp.(operation)))

    # One that is new may write, and who knows what.
    for operation <- [17, 100, 200, 255],
        do:
          assert(
            %Intent{type: "write_file", permission: :maintain, also: [:protection]} = facts(ftp.(operation))
          )

    assert %Intent{permission: :maintain} = facts(%M.ParamSet{})
    assert %Intent{permission: :payload} = facts(%M.MountControl{})
    assert %Intent{permission: :payload} = facts(%M.Storm32GimbalManagerControl{})
    assert %Intent{type: "raw", permission: :maintain} = facts(%M.SerialControl{})
    assert %Intent{type: "raw", permission: :maintain} = facts(%M.SecureCommand{})
  end

  test "a log that is sent: starting and stopping it is an order, the receipts for its blocks are not" do
    for order <- [2_147_483_645, 2_147_483_646],
        do: assert(%Intent{type: "raw", permission: :maintain} = facts(%M.RemoteLogBlockStatus{seqno: order}))

    for block <- [0, 7, 100_000], do: assert(facts(%M.RemoteLogBlockStatus{seqno: block}) == :free)
  end

  test "every message that changes a vehicle has facts, whatever is in it" do
    for id <- All.ids(),
        Messages.order?(id),
        message = struct(All.module_for(id)) do
      for vehicle <- [@copter, @px4, %{autopilot: :generic, vehicle_type: "unknown"}] do
        case facts(message, vehicle) do
          # The table says what is needed at least, and the facts never ask for less.
          %Intent{permission: permission} ->
            least = Messages.row(id).permission
            assert permission in Aerie.Vehicle.Command.Type.permissions()

            assert permission == least or least in [:telemetry, nil] or id in [256, 11],
                   "#{All.name(id)}: #{permission}, not #{least}"

          :free ->
            assert message.__struct__ in [M.FileTransferProtocol, M.RemoteLogBlockStatus]
        end
      end
    end

    random =
      :proper.forall(
        {:proper_types.vector(40, :proper_types.byte()), :proper_types.integer(0, 500)},
        fn {bytes, command} ->
          payload = :erlang.list_to_binary(bytes)

          for id <- [75, 76, 73, 39, 84, 86, 110, 23, 11, 243], version <- [2] do
            {:ok, message} = MavCodec.decode(%{id: id, version: version, payload: payload})
            message = if is_map_key(message, :command), do: %{message | command: command}, else: message

            for vehicle <- [@copter, @px4],
                facts = facts(message, vehicle),
                facts != :free,
                do: %Intent{} = facts
          end

          true
        end
      )

    assert :proper.quickcheck(random, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  test "every refusal has the answer of its own protocol" do
    frame = %Frame{system: 255, component: 190}
    answer = fn message -> Refusal.messages(message, frame, 4) end

    assert [%M.CommandAck{command: 400, result: 2, target_system: 255, target_component: 190}] =
             answer.(long("COMPONENT_ARM_DISARM"))

    assert [%M.CommandAck{command: 192, result: 2}] = answer.(int("DO_REPOSITION", []))
    assert [%M.CommandAck{command: 11, result: 2}] = answer.(%M.SetMode{})

    assert [%M.MissionAck{type: 14, mission_type: 1, target_system: 255}] =
             answer.(%M.MissionCount{mission_type: 1})

    assert [%M.MissionAck{type: 14}] = answer.(%M.MissionItemInt{})
    assert [%M.MissionCurrent{seq: 4}] = answer.(%M.MissionSetCurrent{seq: 9})

    set = %M.ParamExtSet{param_id: "CAM", param_value: <<7>>, param_type: 1, target_component: 100}
    assert [%M.ParamExtAck{param_id: "CAM", param_result: 2, param_type: 1} = ack] = answer.(set)
    # P8: what it carries is the value that stands, so not the refused one.
    assert ack.param_value == <<0::128-unit(8)>>

    assert %M.ParamExtRequestRead{param_id: "CAM", param_index: -1, target_component: 100} =
             Refusal.instead(set)

    # T1: sequence number plus one, NAK, the operation it is about, the error.
    payload = <<41::16-little, 3, 7, 10, 0, 0, 0, 0::32>> <> :binary.copy(<<0>>, 239)

    assert [%M.FileTransferProtocol{payload: nak, target_system: 255}] =
             answer.(%M.FileTransferProtocol{payload: payload})

    assert <<42::16-little, 3, 129, 1, 7, 0, 0, 0::32, 9, _::binary>> = nak
    assert byte_size(nak) == 251
    # P3: the vehicle says which value it has.
    assert %M.ParamRequestRead{param_id: "RTL_ALT", param_index: -1, target_system: 1} =
             Refusal.instead(%M.ParamSet{param_id: "RTL_ALT", target_system: 1})
  end

  test "T: a refused operation that no definition has is unknown to the vehicle, so that a client falls back" do
    frame = %Frame{system: 255, component: 190}

    for {operation, error} <- [{6, 9}, {13, 9}, {17, 7}, {127, 7}, {200, 7}] do
      payload = <<0xFFFF::16-little, 3, operation, 0::size(247 * 8)>>

      [%M.FileTransferProtocol{payload: nak}] =
        Refusal.messages(%M.FileTransferProtocol{payload: payload}, frame, nil)

      assert <<0::16, 3, 129, 1, ^operation, 0, 0, 0::32, ^error, _::binary>> = nak
    end
  end

  test "P8: a camera's parameters need payload; those of the autopilot and of what is not known stay strict" do
    read = fn component, vehicle ->
      Mavlink.facts(%M.ParamExtSet{param_id: "CAM_MODE", target_component: component}, vehicle)
    end

    vehicle = %{autopilot: :px4, vehicle_type: "copter", component: 1}
    for component <- 100..105, do: assert(%Intent{permission: :payload, also: []} = read.(component, vehicle))

    for component <- [0, 1, 25, 99, 106, 154, 191, 255],
        do: assert(%Intent{type: "set_parameter", permission: :maintain} = read.(component, vehicle))

    # An autopilot may have any component.
    assert %Intent{permission: :maintain} = read.(100, %{vehicle | component: 100})
    assert %Intent{permission: :maintain} = read.(100, %{vehicle | component: :unknown})
  end

  test "the reason comes as STATUSTEXT, in chunks where it is long" do
    assert [%M.Statustext{severity: 4, text: "refused: no", id: 0}] = Refusal.texts("no", 7)
    reason = String.duplicate("0123456789", 12)
    texts = Refusal.texts(reason, 7)
    assert Enum.map_join(texts, & &1.text) == "refused: " <> reason
    assert Enum.map(texts, &{&1.id, &1.chunk_seq}) == [{7, 0}, {7, 1}, {7, 2}]
    # The last chunk is short, so that whoever puts them together knows the end (X2).
    assert byte_size(List.last(Refusal.texts(String.duplicate("x", 500), 7)).text) < 50
    assert length(Refusal.texts(String.duplicate("°", 500), 7)) == 4
  end
end
