defmodule Aerie.System.AuthorityAttacksTest do
  @moduledoc """
  Ways around authority that once led to a vehicle, each against a whole gateway. What arrived is counted at the
  vehicle.
  """

  use Aerie.SystemCase, async: true

  import Aerie.AuthorityCase

  alias Aerie.{CountingVehicle, Program}
  alias Aerie.Base.Store
  alias Aerie.Control.Policy.ControlLease.Holders
  alias MavCodec.Enums.MavCmd
  alias MavRouter.Forward.GroundStations
  alias MavRouter.Tables
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @vehicle {"main", 1}
  @force 21_196.0
  # The gateway itself.
  @own 237

  defp encode(message, system, component \\ 190, seq \\ 0),
    do: MavCodec.encode(message, system: system, component: component, seq: seq)

  defp count(counts, id, system), do: Enum.sum(for {{^id, ^system, _command, _seq}, n} <- counts, do: n)

  defp commands(counts, name, system) do
    number = MavCmd.value(:"MAV_CMD_#{name}")
    Enum.sum(for {{_id, ^system, ^number, _seq}, n} <- counts, do: n)
  end

  # From an address that is not this machine's own for the gateway.
  defp stranger(c),
    do: program(c, {:link, lan_address() || flunk("this machine has no IPv4 address but loopback")})

  # What reaches every vehicle that listens, if it gets through.
  defp orders_to_all(system) do
    [
      command("COMPONENT_ARM_DISARM", system,
        param1: 1.0,
        param2: @force,
        target_system: 0,
        target_component: 0
      ),
      command("COMPONENT_ARM_DISARM", system, param2: @force, target_system: 9),
      command("COMPONENT_ARM_DISARM", system, param2: @force),
      encode(%M.SetMode{base_mode: 1, custom_mode: 9}, system),
      encode(%M.ParamSet{param_id: "ARMING_CHECK", param_type: 9}, system),
      encode(%M.ManualControl{z: 1_000}, system),
      encode(%M.RcChannelsOverride{chan3_raw: 1_900}, system),
      encode(%M.SetAttitudeTarget{thrust: 1.0}, system),
      encode(%M.GpsInput{lat: 7}, system)
    ]
  end

  test "a viewer's heartbeat does not keep a vehicle's failsafe quiet", %{tmp_dir: folder} do
    c = start_authority(folder, [:viewer])

    for {way, system} <- [udp: 201, tcp: 202] do
      viewer = program(c, {way, "viewer-#{way}"})
      Program.deliver(viewer, List.duplicate(station(system), 10))
      # As an autopilot of its own.
      Program.deliver(viewer, [encode(%M.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3}, system, 1)])
    end

    operator = program(c, {:tcp, "operator-tcp"})
    Program.deliver(operator, [station(211)])
    counts = settle(c)
    reached_nothing(counts, [201, 202], "a viewer")
    assert count(counts, M.Heartbeat.id(), 211) >= 1
  end

  # H5: ArduPilot takes a heartbeat of its SYSID_MYGCS for its operator's, whatever else it says.
  test "H5: another vehicle's heartbeat does not keep a failsafe quiet that listens to its id", %{
    tmp_dir: folder
  } do
    c = start_authority(folder, [], params: %{"SYSID_MYGCS" => 200.0})

    eventually(
      fn -> match?(%{gcs: %{failsafe_range: {200, 200}}}, Store.vehicle(c.gateway, @vehicle)) end,
      "the gateway has read SYSID_MYGCS"
    )

    beat = %M.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3}
    others = for system <- [200, 150], do: {stranger(c), encode(beat, system, 1)}

    counts =
      eventually(
        fn ->
          for {other, bytes} <- others, do: Program.deliver(other, [bytes])
          counts = settle(c)
          if count(counts, M.Heartbeat.id(), 150) >= 2, do: counts
        end,
        "the heartbeats of the vehicle whose id does not count arrive"
      )

    assert count(counts, M.Heartbeat.id(), 200) == 0
    # An operator's.
    operator = program(c, {:tcp, "operator-tcp"})
    Program.deliver(operator, [station(200)])
    assert c |> settle() |> count(M.Heartbeat.id(), 200) >= 1
  end

  test "H5: while the station's id is not known, no other vehicle's heartbeat reaches ArduPilot", %{
    tmp_dir: folder
  } do
    c = start_authority(folder, [])
    obeyed = fn -> GroundStations.obeyed_by(Tables.of(c.gateway), ["main"], 150) end
    eventually(fn -> obeyed.() == [@vehicle] end, "its session says that any id may count")
    beat = encode(%M.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3}, 150, 1)
    other = stranger(c)
    for _turn <- 1..2, do: Program.deliver(other, [beat])
    c |> settle() |> reached_nothing([150], "another vehicle")
  end

  test "each parameter that shapes a path needs `protection` beyond the limits; without it a speed passes",
       %{tmp_dir: folder} do
    fence = Path.join(folder, "fence.geojson")
    ring = [[8.0, 47.0], [8.03, 47.0], [8.03, 47.02], [8.0, 47.02], [8.0, 47.0]]
    File.write!(fence, JSON.encode!(%{"type" => "Polygon", "coordinates" => [ring]}))

    clients = [
      %{"id" => "marker", "role" => "operator"},
      %{"id" => "operator-udp", "role" => "operator", "permissions" => ["maintain"]},
      %{"id" => "admin-udp", "role" => "admin"}
    ]

    policy = %{
      "geofence_file" => fence,
      "max_altitude" => 60,
      "clients" => clients
    }

    c = start_authority(folder, [:operator, :admin], policy: policy)
    rows = MavCodec.Meaning.Shaping.all()
    unknown = ~w(WP_NAVALT_MIN RTL_LOIT_TIME MIS_YAW_TMT)
    names = Enum.map(rows, & &1.name) ++ unknown

    for {client, system} <- [{"operator-udp", 211}, {"admin-udp", 212}] do
      sets =
        for {name, seq} <- Enum.with_index(names) do
          set = %M.ParamSet{param_id: name, param_type: 9, param_value: 1.0e6}
          encode(struct!(set, target_system: 1, target_component: 1), system, 190, seq)
        end

      Program.deliver(program(c, {:udp, client}), sets)
    end

    counts = settle(c)
    # One that was delivered twice counts once.
    id = M.ParamSet.id()
    set = fn system -> Enum.count(Enum.uniq(for {{^id, ^system, _command, seq}, _n} <- counts, do: seq)) end
    assert set.(212) == length(names)
    assert set.(211) == Enum.count(rows, &(&1.shapes == :speed))
  end

  test "a companion on a link with parts: true is an operator of its own vehicle", %{tmp_dir: folder} do
    parts = %{"id" => "parts", "url" => "udpin:127.0.0.1:0", "gcs" => "deny", "parts" => true}
    links = [%{"id" => "link-1", "url" => "udpin:0.0.0.0:0"}, parts]
    c = start_authority(folder, [], overrides: %{"links" => links})
    companion = program(c, {:udp, "parts"})
    order = fn message -> MavCodec.encode(message, system: 1, component: 191) end
    to = [target_system: 1, target_component: 1]
    Program.deliver(companion, [order.(%M.Heartbeat{type: 18, autopilot: 8, mavlink_version: 3})])

    Program.deliver(companion, [
      order.(struct!(%M.CommandLong{command: 400, param1: 1.0}, to)),
      # An operator may neither.
      order.(struct!(%M.CommandLong{command: 400, param1: 0.0, param2: @force, confirmation: 1}, to)),
      order.(struct!(%M.ParamSet{param_id: "ARMING_CHECK", param_type: 9}, to)),
      order.(%M.SetMode{target_system: 1, base_mode: 1, custom_mode: 6}),
      order.(%M.CommandLong{command: 400, param1: 1.0, confirmation: 2})
    ])

    counts = settle(c)
    assert commands(counts, "COMPONENT_ARM_DISARM", 1) >= 1
    assert count(counts, M.ParamSet.id(), 1) == 0
    assert count(counts, M.SetMode.id(), 1) >= 1
    assert Store.counter(c.gateway, {:policy, :deny, :role}) >= 2
  end

  test "a viewer on this machine is not believed as a part of a vehicle", %{tmp_dir: folder} do
    c = start_authority(folder, [], clients: [%{"role" => "viewer"}])
    local = program(c, {:link, {127, 0, 0, 1}})
    part = fn message -> encode(message, 1, 154) end
    Program.deliver(local, [part.(%M.Heartbeat{type: 26, autopilot: 8, mavlink_version: 3})])

    believed = [
      %M.BatteryStatus{battery_remaining: 3},
      %M.AdsbVehicle{icao_address: 7},
      %M.OpenDroneIdArmStatus{status: 1},
      %M.GimbalDeviceAttitudeStatus{flags: 1},
      %M.GpsInput{lat: 5}
    ]

    Program.deliver(local, Enum.map(believed, part))
    counts = settle(c)
    for %module{} <- believed, do: assert(count(counts, module.id(), 1) == 0, inspect(module))
  end

  # None of them is a command that the gateway has of its own.
  test "what the gateway asks for somebody else has numbers that it would send itself", %{tmp_dir: folder} do
    c = start_authority(folder, [:viewer])
    askers = [{203, stranger(c)}, {201, program(c, {:udp, "viewer-udp"})}]

    wrong = [
      {"GET_MESSAGE_INTERVAL", [param1: :nan]},
      {"GET_MESSAGE_INTERVAL", [param1: 33.5]},
      {"GET_MESSAGE_INTERVAL", [param1: 1.0e9]},
      {"GET_MESSAGE_INTERVAL", [param1: -1.0]},
      {"GET_MESSAGE_INTERVAL", [param1: 33.0, param3: :infinity]},
      {"REQUEST_VIDEO_STREAM_INFORMATION", [param1: :nan]},
      {"REQUEST_STORAGE_INFORMATION", [param1: 0.5]},
      {"LOGGING_START", [param1: 0.0]}
    ]

    for {system, asker} <- askers,
        {name, params} <- wrong,
        do: Program.deliver(asker, [command(name, system, params)])

    counts = settle(c)
    reached_nothing(counts, [203, 201], "who may not ask")
    for {name, _params} <- wrong, do: assert(commands(counts, name, @own) == 0, name)

    # MAVSDK leaves parameters out by NaN.
    {201, viewer} = List.last(askers)
    left_out = for n <- 2..6, do: {:"param#{n}", :nan}
    Program.deliver(viewer, [command("GET_MESSAGE_INTERVAL", 201, [param1: 33.0] ++ left_out)])
    assert c |> settle() |> commands("GET_MESSAGE_INTERVAL", @own) >= 1
  end

  test "a viewer reaches no vehicle that has not spoken yet, by an order to all or to any id", %{
    tmp_dir: folder
  } do
    silent = start_vehicle([])
    links = ["udpout:127.0.0.1:#{CountingVehicle.port(silent)}"]
    c = start_authority(folder, [:viewer], links: links, silent: silent, clients: [%{"role" => "viewer"}])
    viewer = program(c, {:tcp, "viewer-tcp"})
    Program.deliver(viewer, [station(201) | orders_to_all(201)])
    # On this machine, by the link to vehicles: nobody named it but the entry for all.
    local = program(c, {:link, {127, 0, 0, 1}})
    Program.deliver(local, [station(202) | orders_to_all(202)])
    stranger = stranger(c)
    Program.deliver(stranger, [station(203) | orders_to_all(203)])
    c |> settle() |> reached_nothing([201, 202, 203], "somebody who may nothing")
  end

  test "an operator's orders to all, which nobody may give, reach no vehicle that has not spoken yet", %{
    tmp_dir: folder
  } do
    silent = start_vehicle([])

    c =
      start_authority(folder, [], links: ["udpout:127.0.0.1:#{CountingVehicle.port(silent)}"], silent: silent)

    operator = program(c, {:tcp, "operator-tcp"})

    for target <- [0, 1, 9],
        order <- [
          command("COMPONENT_ARM_DISARM", 211, param2: @force, target_system: target),
          command("DO_FLIGHTTERMINATION", 211, param1: 1.0, target_system: target),
          encode(%M.ParamSet{param_id: "ARMING_CHECK", target_system: target}, 211)
        ],
        do: Program.deliver(operator, [order])

    counts = settle(c)
    assert count(counts, M.CommandLong.id(), 211) == 0
    assert count(counts, M.ParamSet.id(), 211) == 0
  end

  test "who may not command cannot suppress an operator's commands by sending them first", %{tmp_dir: folder} do
    c = start_authority(folder, [:viewer])
    operator = program(c, {:tcp, "operator-tcp"})
    copiers = [stranger(c), program(c, {:udp, "viewer-udp"})]
    all = for seq <- 0..255, do: command("NAV_RETURN_TO_LAUNCH", 255, seq: seq)
    # The sender of the copies is known by another way, too.
    for program <- [operator | copiers], do: Program.deliver(program, [station(255)])

    for n <- 1..40 do
      for copier <- copiers, do: Program.deliver(copier, [station(255) | all])
      Program.say(operator, [Enum.at(all, n)])

      eventually(
        fn -> commands(CountingVehicle.counts(c.vehicle), "NAV_RETURN_TO_LAUNCH", 255) >= n end,
        "the operator's #{n}. command reaches the vehicle"
      )
    end

    assert commands(settle(c), "NAV_RETURN_TO_LAUNCH", 255) == 40
  end

  test "what somebody from another address says as a part, a pilot, a battery, an aircraft or the gateway reaches no vehicle",
       %{tmp_dir: folder} do
    c = start_authority(folder, [])
    stranger = stranger(c)
    other = stranger(c)
    Program.deliver(other, [encode(%M.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3}, 77, 1)])

    approvals =
      for {system, component} <- [{237, 191}, {250, 1}, {1, 191}, {77, 1}] do
        encode(%M.CommandAck{command: 3_001, target_system: 1, target_component: 1}, system, component)
      end

    said = fn system ->
      [
        encode(%M.RcChannels{chancount: 16, chan3_raw: 1_900, rssi: 100}, system, 250),
        encode(%M.BatteryStatus{battery_remaining: 1}, system, 190),
        encode(%M.FollowTarget{lat: 473_970_000, lon: 85_460_000}, system),
        encode(%M.AdsbVehicle{icao_address: 7}, system),
        encode(%M.UtmGlobalPosition{lat: 473_970_000}, system),
        encode(%M.Collision{id: 7, threat_level: 2}, system),
        encode(%M.OpenDroneIdArmStatus{status: 1}, system),
        encode(%M.GlobalPositionInt{lat: 473_970_000}, system, 191),
        encode(%M.Timesync{ts1: 7}, system),
        encode(%M.SystemTime{time_unix_usec: 7}, system)
      ]
    end

    for {program, systems} <- [{stranger, [255, 1, 237]}, {other, [77, 1, 237]}],
        system <- systems,
        do: Program.deliver(program, said.(system) ++ approvals)

    lists =
      for {system, component} <- [{1, 1}, {1, 0}, {0, 0}],
          do: encode(%M.ParamRequestList{target_system: system, target_component: component}, 255)

    asked = count(CountingVehicle.counts(c.vehicle), M.ParamRequestList.id(), 237)
    Program.deliver(stranger, Enum.take(Stream.cycle(lists), 1_000))

    counts = settle(c)
    own? = &match?({{_id, 237, _command, _seq}, _n}, &1)
    # A heartbeat is all that vehicles hear of each other.
    heartbeat? = &match?({{0, 77, _command, _seq}, _n}, &1)
    assert Map.reject(counts, &(own?.(&1) or heartbeat?.(&1))) == %{}

    for message <- [
          M.CommandAck,
          M.RcChannels,
          M.BatteryStatus,
          M.FollowTarget,
          M.GlobalPositionInt,
          M.AdsbVehicle
        ],
        do: assert(count(counts, message.id(), 237) == 0)

    assert count(counts, M.ParamRequestList.id(), 237) - asked <= 5
  end

  test "while a vehicle's switches are not known, an operator's channels beyond the sticks reach it by no message",
       %{tmp_dir: folder} do
    c = start_authority(folder, [])
    operator = program(c, {:tcp, "operator-tcp"})
    target = [target_system: 1, target_component: 1]
    left_alone = for n <- 1..8, do: {:"chan#{n}_raw", 65_535}
    override = &struct!(%M.RcChannelsOverride{}, target ++ left_alone ++ &1)

    Program.deliver(operator, [
      station(211),
      encode(override.(chan5_raw: 2_000), 211),
      encode(override.(chan7_raw: 2_000), 211),
      encode(override.(chan8_raw: 0, chan9_raw: 1_000), 211),
      encode(override.(chan16_raw: 65_534, chan15_raw: 900), 211),
      encode(struct!(%M.RadioRcChannels{count: 16, channels: List.duplicate(4_096, 32)}, target), 211),
      encode(%M.CubepilotRawRc{rc_raw: :binary.copy(<<7>>, 32)}, 211),
      encode(%M.RcChannels{chancount: 16, chan7_raw: 2_000}, 211)
    ])

    counts = settle(c)
    reached = for {{id, 211, _command, _seq}, _n} <- counts, id != M.Heartbeat.id(), do: id
    assert reached == []

    Program.deliver(operator, [encode(override.(chan1_raw: 1_500, chan3_raw: 1_200), 211)])
    assert count(settle(c), M.RcChannelsOverride.id(), 211) >= 1
  end

  test "no item of a mission brings what its command may not, by any `current` and any `mission_type`", %{
    tmp_dir: folder
  } do
    c = start_authority(folder, [])
    operator = program(c, {:tcp, "operator-tcp"})
    unknown = [43_999, 65_535]

    names =
      ~w(DO_FLIGHTTERMINATION DO_PARACHUTE INJECT_FAILURE NAV_SCRIPT_TIME DO_SET_HOME DO_MOTOR_TEST DEBUG_TRAP)

    items =
      for command <- unknown ++ Enum.map(names, &MavCmd.value(:"MAV_CMD_#{&1}")),
          current <- [0, 2, 3],
          type <- [0, 1, 2, 3, 255],
          do: %M.MissionItemInt{
            target_system: 1,
            target_component: 1,
            seq: 3,
            command: command,
            current: current,
            mission_type: type,
            param1: 2.0
          }

    # A waypoint is no part of a fence, of rally points, and of what has no name.
    others =
      for type <- [1, 2, 3, 255],
          current <- [0, 2],
          do: %{hd(items) | command: 16, mission_type: type, current: current}

    counts =
      for type <- [3, 254, 255],
          do: %M.MissionCount{target_system: 1, target_component: 1, count: 1, mission_type: type}

    clear = %M.MissionClearAll{target_system: 1, target_component: 1, mission_type: 255}

    Program.deliver(operator, [
      station(211) | for(m <- items ++ others ++ counts ++ [clear], do: encode(m, 211))
    ])

    reached = for {{id, 211, _command, _seq}, _n} <- settle(c), id != M.Heartbeat.id(), do: id
    assert reached == []
  end

  test "where a height is limited, an operator gives estimators nothing without `inputs`; corrections pass",
       %{
         tmp_dir: folder
       } do
    # An entry without an id is for `mavlink.sock`.
    helper = [%{"role" => "operator", "permissions" => ["inputs"]}]
    c = start_authority(folder, [], policy: %{"max_altitude" => 60}, clients: helper)
    operator = program(c, {:tcp, "operator-tcp"})
    helper = program(c, :unix)

    inputs = fn system ->
      [
        encode(%M.GpsInput{lat: 7}, system),
        encode(%M.HilGps{lat: 7}, system),
        encode(%M.GlobalPositionInt{lat: 7}, system),
        encode(%M.BatteryStatus{battery_remaining: 1}, system),
        encode(%M.VisionPositionEstimate{x: 1.0}, system),
        encode(%M.Odometry{x: 1.0}, system),
        encode(%M.AttPosMocap{x: 1.0}, system),
        encode(%M.LandingTarget{x: 1.0}, system),
        encode(%M.DistanceSensor{current_distance: 7}, system),
        encode(%M.ObstacleDistance{min_distance: 7}, system)
      ]
    end

    reached = fn counts, system ->
      Enum.sort(for {{id, ^system, _command, _seq}, _n} <- counts, id != M.Heartbeat.id(), uniq: true, do: id)
    end

    Program.deliver(operator, [station(211) | inputs.(211)] ++ [encode(%M.GpsRtcmData{len: 7}, 211)])
    Program.deliver(helper, [station(212) | inputs.(212)])
    counts = settle(c)
    assert reached.(counts, 211) == [M.GpsRtcmData.id()]
    assert reached.(counts, 212) |> length() == length(inputs.(212))
  end

  describe "while a program is in charge" do
    setup %{tmp_dir: folder} do
      c = start_authority(folder, [])
      one = program(c, {:tcp, "operator-tcp"})
      two = program(c, {:tcp, "operator-tcp"})
      for {program, system} <- [{one, 255}, {two, 250}], do: Program.deliver(program, [station(system)])
      Program.deliver(one, [command("REQUEST_OPERATOR_CONTROL", 255, param1: 1.0)])
      lease = eventually(fn -> Holders.of(c.gateway, @vehicle) end, "the first one is in charge")
      {:ok, Map.merge(c, %{one: one, two: two, lease: lease})}
    end

    test "a second one at the same endpoint commands nothing, releases nothing, and is told apart from it",
         c do
      arm = command("COMPONENT_ARM_DISARM", 250, param1: 1.0)
      Program.deliver(c.two, [command("REQUEST_OPERATOR_CONTROL", 250), arm])
      # By another name for itself, which is the first one's.
      as_first = command("COMPONENT_ARM_DISARM", 255, param1: 1.0)
      Program.deliver(c.two, [command("REQUEST_OPERATOR_CONTROL", 255), as_first])
      # And at the link to vehicles, from this machine.
      Program.deliver(program(c, {:link, {127, 0, 0, 1}}), [station(255), as_first])
      counts = settle(c)
      assert commands(counts, "COMPONENT_ARM_DISARM", 250) == 0
      assert commands(counts, "COMPONENT_ARM_DISARM", 255) == 0
      assert Holders.of(c.gateway, @vehicle).holder == c.lease.holder

      Program.deliver(c.one, [as_first])
      assert commands(settle(c), "COMPONENT_ARM_DISARM", 255) >= 1
    end

    test "others neither steer nor feed the estimators; they may hold the vehicle, and not resume", c do
      other = program(c, {:udp, "operator-udp"})

      for {program, system} <- [{c.two, 250}, {other, 251}] do
        Program.deliver(program, [
          station(system),
          encode(%M.GpsInput{lat: 7}, system),
          encode(%M.Odometry{x: 1.0}, system),
          encode(%M.RcChannels{chancount: 16, chan3_raw: 1_900}, system, 250),
          encode(%M.RcChannelsOverride{target_system: 1, target_component: 1, chan3_raw: 1_900}, system),
          encode(%M.FollowTarget{lat: 473_970_000, lon: 85_450_000}, system),
          encode(%M.BatteryStatus{battery_remaining: 1}, system),
          command("DO_PAUSE_CONTINUE", system, param1: 1.0)
        ])

        kept = Map.keys(settle(c)) |> Enum.filter(&(elem(&1, 1) == system)) |> Enum.map(&elem(&1, 0))
        assert Enum.uniq(kept) -- [M.Heartbeat.id()] == []

        Program.deliver(program, [command("DO_PAUSE_CONTINUE", system, param1: 0.0)])
        assert commands(settle(c), "DO_PAUSE_CONTINUE", system) >= 1
      end

      Program.deliver(c.one, [encode(%M.GpsInput{lat: 7}, 255)])
      assert count(settle(c), M.GpsInput.id(), 255) >= 1
    end

    test "a client that is gone is not in charge for ever: another one may take over then, and not before",
         c do
      take = command("REQUEST_OPERATOR_CONTROL", 250, param1: 1.0)
      arm = command("COMPONENT_ARM_DISARM", 250, param1: 1.0)
      Program.deliver(c.two, [take, arm])
      assert Holders.of(c.gateway, @vehicle).holder == c.lease.holder
      Program.close(c.one)

      lease =
        eventually(
          fn ->
            Program.deliver(c.two, [take])
            lease = Holders.of(c.gateway, @vehicle)
            if lease.holder != c.lease.holder, do: lease
          end,
          "the second one has taken over"
        )

      assert lease.endpoint != c.lease.endpoint
      assert commands(settle(c), "COMPONENT_ARM_DISARM", 250) == 0
      Program.deliver(c.two, [arm])
      assert commands(settle(c), "COMPONENT_ARM_DISARM", 250) >= 1
    end
  end
end
