defmodule SimVehicle.Px4Test do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Real32}

  @home {47.397742, 8.545594, 489.0}
  @items [
    %{command: 22, frame: 6, x: 473_977_420, y: 85_455_940, z: 12.0, param4: :nan},
    %{command: 16, frame: 6, x: 473_979_420, y: 85_455_940, z: 15.0, param4: :nan},
    %{command: 178, frame: 2, x: 0, y: 0, z: 0.0, param2: 8.0},
    %{command: 16, frame: 6, x: 473_979_420, y: 85_458_940, z: 15.0, param4: :nan},
    %{command: 20, frame: 2, x: 0, y: 0, z: 0.0}
  ]

  describe "boot" do
    test "some parameters come unasked, events start at 65526 and wrap" do
      flight = boot(:px4)
      assert "SYS_AUTOSTART" in Enum.map(sent(flight, M.ParamValue), & &1.param_id)
      assert [%{sequence: 65_526}] = sent(flight, M.Event)

      flight = Enum.reduce(1..12, ready(:px4), fn _n, flight -> command(flight, 400, [7.0]) end)
      sequences = flight |> sent(M.Event) |> Enum.map(& &1.sequence)
      assert 65_535 in sequences and 0 in sequences
    end

    test "state 0 until it knows itself, then standby; the mode is hold" do
      flight = :px4 |> boot() |> run(6)

      assert [{_t, {0, 50_593_792}}, {_later, {3, 50_593_792}}] =
               changes(flight, M.Heartbeat, &{&1.system_status, &1.custom_mode})
    end

    test "texts are held back while no ground station is heard, events are not" do
      flight = :px4 |> boot() |> run(5) |> command(400, [7.0])
      assert sent(flight, M.Statustext) == []
      assert length(sent(flight, M.Event)) == 2
      assert ["Unsupported ARM_DISARM param: 7.000\t"] = flight |> heartbeat() |> texts()
    end
  end

  describe "acknowledgements" do
    test "a mode is acknowledged twice: yes at once, then the truth" do
      assert :px4 |> ready() |> mode([1.0, 6.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 0}]
      assert :px4 |> flying() |> mode([1.0, 6.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 1}]
      assert :px4 |> flying() |> mode([1.0, 3.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 1}]
    end

    test "a nonsense main mode is twice accepted and changes nothing; a nonsense sub mode is rejected" do
      assert :px4 |> ready() |> mode([1.0, 99.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 0}]
      flight = :px4 |> ready() |> mode([1.0, 4.0, 77.0]) |> run(0.1)
      assert acks(flight) == [{176, 0}, {176, 1}]
      assert "Unsupported auto mode\t" in texts(flight)
    end

    test "no answer: another system or component, arming with 7, gimbal, transition, an unknown unit" do
      for flight <- [
            command(ready(:px4), 400, [1.0], system: 77),
            command(ready(:px4), 400, [1.0], component: 77),
            command(ready(:px4), 400, [7.0]),
            command(ready(:px4), 205),
            command(ready(:px4), 3000, [4.0]),
            command(ready(:px4), 420, [0.0, 1.0])
          ],
          do: assert(acks(flight) == [])
    end

    test "the failure of a battery is acknowledged to everybody" do
      assert [%{target_system: 0, target_component: 0, result: 0}] =
               :px4 |> ready() |> command(420, [100.0, 1.0]) |> sent(M.CommandAck)
    end

    test "UNSUPPORTED: unknown, DO_SET_MISSION_CURRENT, DO_PAUSE_CONTINUE, image capture" do
      assert :px4 |> ready() |> command(31_999) |> command(224) |> command(193) |> command(2000) |> acks() ==
               [{31_999, 3}, {224, 3}, {193, 3}, {2000, 3}]
    end

    test "in flight: reboot DENIED, storage and calibration TEMPORARILY_REJECTED, motor test DENIED" do
      assert :px4
             |> flying()
             |> command(246, [1.0])
             |> command(245, [2.0])
             |> command(241, [1.0])
             |> command(310)
             |> acks() ==
               [{246, 2}, {245, 1}, {241, 1}, {310, 2}]
    end

    test "unknown messages: 512 DENIED, 511 FAILED; a known one comes before its acknowledgement" do
      assert :px4 |> ready() |> command(512, [60_000.0]) |> command(511, [60_000.0, 1.0]) |> acks() == [
               {512, 2},
               {511, 4}
             ]

      {_v, log} = :px4 |> ready() |> command(512, [148.0])
      assert [{_t, {:send, %M.AutopilotVersion{}}}, {_u, {:send, %M.CommandAck{}}}] = log
    end

    test "home at latitude 95 is accepted and shown" do
      message = %M.CommandInt{
        target_system: 1,
        target_component: 1,
        command: 179,
        frame: 5,
        x: 950_000_000,
        y: 85_455_967,
        z: 489.0
      }

      flight = :px4 |> ready() |> hear(message) |> run(3)
      assert acks(flight) == [{179, 0}]
      assert flight |> sent(M.HomePosition) |> List.last() |> Map.fetch!(:latitude) == 950_000_000
    end
  end

  describe "arming" do
    test "before there is a position, and in modes that cannot be flown" do
      flight = :px4 |> boot() |> heartbeat() |> run(1) |> command(400, [1.0])
      assert {400, 1} in acks(flight)
      # Critical to people, information to the log: as 1.17.0 sends it.
      assert %{id: 16_910_493, log_levels: 0x62} = List.last(sent(flight, M.Event))
      assert ["Arming denied: Resolve system health failures firs", "t\t"] = Enum.take(texts(flight), -2)

      assert [{0, 0}, {0, 1}] =
               flight |> sent(M.Statustext) |> Enum.take(-2) |> Enum.map(&{&1.id - &1.id, &1.chunk_seq})

      for mode <- [[1.0, 3.0], [1.0, 6.0], [1.0, 4.0, 4.0]] do
        assert {400, 1} in (:px4 |> ready() |> mode(mode) |> command(400, [1.0]) |> acks())
      end
    end

    test "armed, with an event and its double with a tab" do
      flight = :px4 |> ready() |> command(400, [1.0])
      assert acks(flight) == [{400, 0}]
      assert texts(flight) == ["Armed by external command\t"]
      assert [%{id: 26_266_355, log_levels: 0x66, arguments: <<4, _rest::binary>>}] = sent(flight, M.Event)
    end

    test "not flown it disarms after ten seconds; in flight it cannot be disarmed" do
      flight = :px4 |> ready() |> command(400, [1.0]) |> run(10.1) |> heartbeat()
      assert List.last(texts(flight)) == "Disarmed by auto preflight disarming\t"
      flight = :px4 |> flying() |> heartbeat() |> command(400, [0.0])
      assert acks(flight) == [{400, 1}]
      assert texts(flight) == ["Disarming denied: not landed\t"]
    end
  end

  describe "flight" do
    test "the sequence of a whole flight is that of the recordings" do
      flight =
        :px4
        |> ready()
        |> command(511, [245.0, 100_000.0])
        |> command(400, [1.0])
        |> run(0.2)
        |> takeoff(12)
        |> run(16)
        |> heartbeat()
        |> command(21, [0.0, 0.0, 0.0, :nan, :nan, :nan, :nan])
        |> until(&(not &1.armed), 60)
        |> heartbeat()
        |> run(1.5)

      assert acks(flight) == [{511, 0}, {400, 0}, {22, 0}, {21, 0}]

      assert flight |> changes(M.ExtendedSysState, & &1.landed_state) |> Enum.map(&elem(&1, 1)) == [
               1,
               3,
               2,
               4,
               1
             ]

      assert flight |> changes(M.Heartbeat, & &1.custom_mode) |> Enum.map(&elem(&1, 1)) ==
               [50_593_792, 33_816_576, 50_593_792, 100_925_440, 50_593_792]

      assert texts(flight) ==
               [
                 "Armed by external command\t",
                 "Takeoff detected\t",
                 "Landing at current position\t",
                 "Landing detected\t",
                 "Disarmed by landing\t"
               ]
    end

    test "a height below the clearance (10 m above the sea, as MAVProxy asks) is raised to it, and that is said" do
      flight =
        :px4
        |> ready()
        |> command(400, [1.0])
        |> clear()
        |> command(22, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0])
        |> run(14)

      assert acks(flight) == [{22, 0}]
      assert ["Using minimum takeoff altitude: 2.50 m\t" | _rest] = texts(flight)
      {vehicle, _log} = flight
      assert_in_delta -vehicle.kin.d, 2.5, 0.3
    end

    test "a second flight is as the first" do
      land = [0.0, 0.0, 0.0, :nan, :nan, :nan, :nan]

      once = fn flight ->
        flight
        |> command(400, [1.0])
        |> takeoff(12)
        |> run(14)
        |> command(21, land)
        |> until(&(not &1.armed), 60)
      end

      flight = :px4 |> ready() |> once.() |> run(5) |> clear() |> once.()
      assert acks(flight) == [{400, 0}, {22, 0}, {21, 0}]
      assert :landed in events(flight)
    end

    test "its own commands leak out four times, from itself to itself" do
      flight =
        :px4
        |> flying()
        |> run(3)
        |> clear()
        |> command(21, [0.0, 0.0, 0.0, :nan, :nan, :nan, :nan])
        |> run(3)

      leaked = sent(flight, M.CommandLong)
      assert Enum.all?(leaked, &(&1.target_system == 1 and &1.target_component == 0))
      assert for(%{command: 1001, param1: 1.0} = c <- leaked, do: c.confirmation) == [0, 1, 2, 3]
    end

    test "DO_REPOSITION flies there, DO_ORBIT circles in a mode of its own" do
      go = %M.CommandInt{
        target_system: 1,
        target_component: 1,
        command: 192,
        frame: 5,
        param1: -1.0,
        param2: 1.0,
        param4: :nan,
        x: 473_979_420,
        y: 85_455_940,
        z: 510.0
      }

      {v, _log} = flight = :px4 |> flying(15, home: @home) |> hear(go) |> run(12)
      assert {192, 0} in acks(flight)
      assert_in_delta v.kin.n, 22.3, 1.0

      orbit = %{go | command: 34, param1: 8.0, param2: 3.0}
      flight = flight |> clear() |> hear(orbit) |> run(20)
      assert acks(flight) == [{34, 0}]
      assert [{_t, 16_973_824}] = changes(flight, M.Heartbeat, & &1.custom_mode)
      assert [%{radius: 8.0} | _more] = sent(flight, M.OrbitExecutionStatus)
      {v, _log} = flight
      assert_in_delta SimVehicle.Kinematics.distance(v.kin, 22.26, 0.0), 8.0, 3.0
    end

    test "OFFBOARD needs a stream of setpoints, and is left when it stops (X7)" do
      target = %M.SetPositionTargetLocalNed{
        target_system: 1,
        target_component: 1,
        coordinate_frame: 1,
        type_mask: 0xFC7,
        vy: 3.0
      }

      stream = fn flight ->
        Enum.reduce(1..20, flight, fn _n, flight -> flight |> hear(target) |> run(0.05) end)
      end

      flight = :px4 |> flying() |> stream.() |> mode([1.0, 6.0]) |> stream.() |> stream.()
      assert acks(flight) == [{176, 0}, {176, 0}]
      assert vehicle(flight).mode == "OFFBOARD"
      assert_in_delta vehicle(flight).kin.ve, 3.0, 0.8
      flight = flight |> heartbeat() |> run(2)
      assert vehicle(flight).mode == "AUTO_LOITER"
      assert "Failsafe activated: entering Hold for 5 seconds\t" in texts(flight)
      assert (flight |> run(5) |> vehicle()).mode == "AUTO_RTL"
    end

    test "RTL says at what height it returns, in two chunks" do
      go = %M.CommandInt{
        target_system: 1,
        target_component: 1,
        command: 192,
        frame: 5,
        param2: 1.0,
        param4: :nan,
        x: 473_979_420,
        y: 85_455_940,
        z: 509.0
      }

      flight =
        :px4
        |> flying(15, home: @home)
        |> hear(go)
        |> run(12)
        |> heartbeat()
        |> clear()
        |> command(20)
        |> heartbeat()
        |> run(1)

      assert ["Returning to launch\t", "RTL: start return at 519 m (30 m above destination", ")\t"] =
               texts(flight)

      flight = until(flight, &(not &1.armed), 120)
      assert "RTL: land at destination\t" in (flight |> heartbeat() |> texts())
    end
  end

  describe "mission" do
    setup do
      %{flight: ready(:px4, home: @home)}
    end

    test "is asked for with MISSION_REQUEST_INT and acknowledged with an opaque id (W7)", %{flight: flight} do
      assert [%{total: 65_535, mission_state: 1} | _more] = flight |> run(2) |> sent(M.MissionCurrent)
      flight = upload(flight, @items)
      assert flight |> sent(M.MissionRequestInt) |> Enum.map(& &1.seq) == [0, 1, 2, 3, 4]
      assert [%{type: 0, opaque_id: id}] = sent(flight, M.MissionAck)
      assert id != 0

      assert %{total: 5, mission_state: 2, mission_id: ^id} =
               flight |> run(2) |> sent(M.MissionCurrent) |> List.last()
    end

    test "refused: a command (3), a frame (2), too many (4); out of sequence is asked for again", %{
      flight: flight
    } do
      assert [%{type: 3}] =
               flight
               |> upload([hd(@items), %{command: 31_000, frame: 3, x: 0, y: 0, z: 1.0}])
               |> sent(M.MissionAck)

      assert [%{type: 2}] =
               flight
               |> upload([hd(@items), %{command: 16, frame: 11, x: 0, y: 0, z: 1.0}])
               |> sent(M.MissionAck)

      count = %M.MissionCount{target_system: 1, target_component: 1, count: 20_000}
      assert [%{type: 4}] = flight |> hear(count) |> sent(M.MissionAck)
      late = %M.MissionItemInt{target_system: 1, target_component: 1, seq: 3, command: 16, frame: 3}
      flight = flight |> hear(%{count | count: 5}) |> hear(late)
      assert flight |> sent(M.MissionRequestInt) |> Enum.map(& &1.seq) == [0, 0]
    end

    test "accepted and then found infeasible, which only an event tells", %{flight: flight} do
      flight =
        flight
        |> handle({:set_param, "MIS_TKO_LAND_REQ", 1})
        |> upload(tl(@items))
        |> mode([1.0, 4.0, 4.0])
        |> command(400, [1.0])

      assert [%{type: 0}] = sent(flight, M.MissionAck)
      assert 22_271_714 in Enum.map(sent(flight, M.Event), & &1.id)
      assert {400, 1} in acks(flight)
    end

    test "MISSION_START without one is DENIED", %{flight: flight} do
      flight = command(flight, 300)
      assert acks(flight) == [{300, 2}]
      assert texts(flight) == ["Mission start denied! No valid mission\t"]
    end

    test "flown from the ground: reached items are told again and again, the RTL item changes the mode", %{
      flight: flight
    } do
      flight =
        flight
        |> upload(@items)
        |> mode([1.0, 4.0, 4.0])
        |> command(400, [1.0])
        |> heartbeat()
        |> until(&(&1.mode == "AUTO_RTL"), 120)

      flight = until(flight, &(not &1.armed), 120)
      reached = flight |> sent(M.MissionItemReached) |> Enum.map(& &1.seq)
      # 1 and 3 are hidden by the actions right behind them, as in the recordings.
      assert Enum.dedup(reached) == [0, 2, 4]
      assert Enum.count(reached, &(&1 == 0)) > 3
      assert for(%{command: 20} = c <- sent(flight, M.CommandLong), do: c.confirmation) == [0, 1, 2, 3]
    end
  end

  describe "parameters" do
    test "integers are bytes in floats (P2), _HASH_CHECK comes first with index 65535 (P6)" do
      flight = :px4 |> ready() |> hear(%M.ParamRequestList{target_system: 1, target_component: 1}) |> run(2)
      [hash | values] = sent(flight, M.ParamValue)
      assert {hash.param_id, hash.param_index, hash.param_type} == {"_HASH_CHECK", 65_535, 5}
      assert Real32.to_bits(hash.param_value) == Params.hash(vehicle(flight).params)
      assert length(values) == hash.param_count
      start = Enum.find(values, &(&1.param_id == "SYS_AUTOSTART"))
      assert Real32.to_bits(start.param_value) == 10_040
    end

    test "a changed value is told twice and changes the hash; a wrong type and an unknown name are not answered" do
      set = %M.ParamSet{
        target_system: 1,
        target_component: 1,
        param_id: "MIS_TKO_LAND_REQ",
        param_value: Real32.from_bits(1),
        param_type: 6
      }

      {v, _log} = flight = ready(:px4)
      changed = flight |> hear(set) |> run(0.1)
      assert [%{param_id: "MIS_TKO_LAND_REQ"}, %{param_id: "MIS_TKO_LAND_REQ"}] = sent(changed, M.ParamValue)
      assert Params.hash(vehicle(changed).params) != Params.hash(v.params)
      assert flight |> hear(%{set | param_type: 9}) |> run(0.1) |> sent(M.ParamValue) == []
      assert flight |> hear(%{set | param_id: "NO_SUCH"}) |> run(0.1) |> sent(M.ParamValue) == []
    end

    test "a negative integer survives as the NaN that its bytes are" do
      set = %M.ParamSet{
        target_system: 1,
        target_component: 1,
        param_id: "COM_LOW_BAT_ACT",
        param_value: {:nan, 0xFFFF_FFFF},
        param_type: 6
      }

      flight = :px4 |> ready() |> hear(set)
      assert Params.get(vehicle(flight).params, "COM_LOW_BAT_ACT") == -1
      assert [%{param_value: {:nan, 0xFFFF_FFFF}}] = sent(flight, M.ParamValue)
    end
  end

  describe "events (X3)" do
    test "are sent again when asked for; one that is not kept gives an error with the oldest" do
      flight = :px4 |> ready() |> command(400, [7.0]) |> clear()

      ask = %M.RequestEvent{
        target_system: 1,
        target_component: 1,
        first_sequence: 65_526,
        last_sequence: 65_527
      }

      assert flight |> hear(ask) |> sent(M.Event) |> Enum.map(& &1.sequence) == [65_526, 65_527]

      assert [%{sequence: 9, sequence_oldest_available: 65_526, reason: 0}] =
               flight |> hear(%{ask | first_sequence: 9, last_sequence: 9}) |> sent(M.ResponseEventError)
    end
  end

  describe "services" do
    test "PING to nobody in particular and TIMESYNC are answered (X5)" do
      flight = :px4 |> ready() |> hear(%M.Ping{time_usec: 7, seq: 3}) |> hear(%M.Timesync{tc1: 0, ts1: 99})
      assert [%{time_usec: 7, seq: 3, target_system: 255, target_component: 190}] = sent(flight, M.Ping)
      assert [%{ts1: 99, tc1: tc1}] = sent(flight, M.Timesync)
      assert tc1 > 0
      assert :px4 |> ready() |> hear(%M.Timesync{tc1: 5, ts1: 99}) |> sent(M.Timesync) == []
    end

    test "all modes are listed" do
      modes = :px4 |> ready() |> command(512, [435.0]) |> sent(M.AvailableModes)
      assert Enum.map(modes, & &1.mode_index) == Enum.to_list(1..length(modes))
      assert Enum.all?(modes, &(&1.number_modes == length(modes)))
    end
  end

  describe "failsafes" do
    test "critical battery holds five seconds, then returns; the heartbeat is critical" do
      flight = :px4 |> flying() |> heartbeat() |> handle({:failsafe, :battery_critical, true}) |> run(2)
      assert vehicle(flight).mode == "AUTO_LOITER"
      assert flight |> sent(M.Heartbeat) |> List.last() |> Map.fetch!(:system_status) == 5
      # Action RTL after five seconds, because the battery is critical.
      assert Enum.any?(
               sent(flight, M.Event),
               &match?(%{id: 30_481_910, arguments: <<_mode::32, 6, 5, 0, 4, _::binary>>}, &1)
             )

      flight = run(flight, 4)
      assert vehicle(flight).mode == "AUTO_RTL"
      flight = flight |> until(&(not &1.armed), 120) |> command(400, [1.0])
      assert {400, 1} in acks(flight)
    end

    test "who is lost is reported, and who is back" do
      ids = fn flight -> for event <- sent(flight, M.Event), do: event.id end
      flight = :px4 |> flying() |> handle({:failsafe, :gcs, true}) |> handle({:failsafe, :rc, true})
      assert [27_571_288, 22_400_324] -- ids.(flight) == []
      flight = flight |> handle({:failsafe, :gcs, false}) |> handle({:failsafe, :rc, false})
      assert [31_011_876, 17_490_621] -- ids.(flight) == []
    end

    test "no position lands" do
      assert (:px4 |> flying() |> handle({:failsafe, :gps, true}) |> vehicle()).mode == "AUTO_LAND"
    end
  end
end
