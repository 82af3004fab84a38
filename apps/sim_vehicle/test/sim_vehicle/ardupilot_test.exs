defmodule SimVehicle.ArdupilotTest do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Plans, Vehicle}

  describe "boot" do
    test "bytes outside any frame come first, then the banner; the mode is STABILIZE" do
      {v, log} = :ardupilot |> boot() |> run(2.5)
      assert [{+0.0, {:bytes, "\n\nInit ArduCopter V4.6.3 (92b0cd78)" <> _rest}} | _actions] = log
      assert "ArduCopter V4.6.3 (92b0cd78)" in texts({v, log})
      assert "ArduPilot Ready" in texts({v, log})
      assert v.mode == "STABILIZE"
    end

    test "HEARTBEAT says boot, then standby; there is no position and no fix" do
      flight = :ardupilot |> boot() |> run(9)
      assert [{_at, 1}, {_later, 3}] = changes(flight, M.Heartbeat, & &1.system_status)
      assert [%{fix_type: 0, lat: 0, eph: 65_535} | _more] = sent(flight, M.GpsRawInt)
      assert [%{lat: 0, lon: 0} | _more] = sent(flight, M.GlobalPositionInt)
      assert sent(flight, M.LocalPositionNed) == []
      assert sent(flight, M.HomePosition) == []
    end

    test "EXTENDED_SYS_STATE comes only when it is asked for" do
      flight = :ardupilot |> boot() |> run(5)
      assert sent(flight, M.ExtendedSysState) == []
      flight = flight |> command(511, [245.0, 500_000.0]) |> run(2)
      assert {511, 0} in acks(flight)
      assert length(sent(flight, M.ExtendedSysState)) in 3..4
    end
  end

  describe "refusals" do
    test "takeoff while disarmed is 4 FAILED, an unknown command 3 UNSUPPORTED" do
      flight = :ardupilot |> ready() |> takeoff(20) |> command(31_999)
      assert acks(flight) == [{22, 4}, {31_999, 3}]
    end

    test "the acknowledgement is addressed to who asked" do
      [ack] = :ardupilot |> ready() |> command(31_999) |> sent(M.CommandAck)
      assert {ack.target_system, ack.target_component} == {255, 190}
    end

    test "a command for another system is passed over, one for an unknown component of this system is not" do
      assert :ardupilot |> ready() |> command(400, [1.0], system: 77) |> acks() == []
      assert :ardupilot |> ready() |> command(31_999, [], component: 77) |> acks() == [{31_999, 3}]
    end

    test "arming without a position: FAILED, with the reasons" do
      flight = :ardupilot |> boot() |> run(5) |> mode([1.0, 4.0]) |> command(400, [1.0])
      assert {400, 4} in acks(flight)
      assert "Arm: GPS 1: Bad fix" in texts(flight)
      assert "Arm: Need Position Estimate" in texts(flight)
      refute vehicle(flight).armed
    end

    test "STABILIZE can be armed without a position, LAND cannot be armed at all" do
      assert {400, 0} in (:ardupilot |> boot() |> run(5) |> command(400, [1.0]) |> acks())
      flight = :ardupilot |> ready() |> mode([1.0, 9.0]) |> command(400, [1.0])
      assert {400, 4} in acks(flight)
      assert "Arm: LAND mode not armable" in texts(flight)
    end

    test "arming with neither 0 nor 1 is UNSUPPORTED" do
      assert :ardupilot |> ready() |> command(400, [7.0]) |> acks() == [{400, 3}]
    end

    test "a mode that there is not, and a mode without the custom flag" do
      flight = :ardupilot |> ready() |> mode([1.0, 99.0]) |> mode([0.0, 4.0])
      assert acks(flight) == [{176, 4}, {176, 2}]
      assert "No such mode 99" in texts(flight)
      assert vehicle(flight).mode == "STABILIZE"
    end

    test "AUTO without a mission while armed" do
      flight = :ardupilot |> flying() |> mode([1.0, 3.0])
      assert acks(flight) == [{176, 4}]
      assert "Mode change to AUTO failed: init failed" in texts(flight)
    end

    test "a position mode while the position is lost in flight" do
      flight = :ardupilot |> flying() |> handle({:failsafe, :gps, true}) |> clear() |> mode([1.0, 5.0])
      assert acks(flight) == [{176, 4}]
      assert "Mode change to LOITER failed: requires position" in texts(flight)
    end

    test "disarming in flight is FAILED; forced, it falls" do
      flight = :ardupilot |> flying() |> command(400, [0.0])
      assert acks(flight) == [{400, 4}]
      flight = flight |> command(400, [0.0, 21_196.0]) |> until(&(not &1.airborne), 10)
      assert {400, 0} in acks(flight)
      refute vehicle(flight).armed
    end

    test "SET_MODE is acknowledged with its own message id" do
      flight = :ardupilot |> ready() |> hear(%M.SetMode{target_system: 1, base_mode: 1, custom_mode: 4})
      assert acks(flight) == [{11, 0}]
    end

    test "takeoff below the present height, in a mode without takeoff, and in the air" do
      flight = :ardupilot |> ready() |> command(400, [1.0]) |> takeoff(20)
      assert {22, 4} in acks(flight)
      flight = :ardupilot |> ready() |> mode([1.0, 4.0]) |> command(400, [1.0]) |> takeoff(-5)
      assert {22, 4} in acks(flight)
      assert :ardupilot |> flying() |> takeoff(30) |> acks() == [{22, 4}]
    end

    test "reboot: FAILED while armed, else acknowledged first" do
      assert :ardupilot |> flying() |> command(246, [1.0]) |> acks() == [{246, 4}]
      flight = :ardupilot |> ready() |> command(246, [1.0])
      assert acks(flight) == [{246, 0}]
      assert events(flight) == [:rebooting]
    end

    test "home beyond the globe is DENIED" do
      message = %M.CommandInt{
        target_system: 1,
        target_component: 1,
        command: 179,
        frame: 0,
        x: 950_000_000,
        y: 0,
        z: 1.0
      }

      assert :ardupilot |> ready() |> hear(message) |> acks() == [{179, 2}]
    end

    test "a message that it does not stream: 511 and 512 are FAILED" do
      flight = :ardupilot |> ready() |> command(512, [60_000.0]) |> command(511, [60_000.0, 1000.0])
      assert acks(flight) == [{512, 4}, {511, 4}]
    end
  end

  describe "flight" do
    test "the sequence of a whole flight is that of the recordings" do
      flight =
        :ardupilot
        |> ready()
        |> command(511, [245.0, 100_000.0])
        |> mode([1.0, 4.0])
        |> command(400, [1.0])
        |> takeoff(20)
        |> run(16)
        |> mode([1.0, 9.0])
        |> until(&(not &1.armed), 60)
        |> run(1.5)

      assert acks(flight) == [{511, 0}, {176, 0}, {400, 0}, {22, 0}, {176, 0}]

      assert flight |> changes(M.ExtendedSysState, & &1.landed_state) |> Enum.map(&elem(&1, 1)) == [
               1,
               3,
               2,
               4,
               1
             ]

      assert flight
             |> changes(M.Heartbeat, &{&1.base_mode, &1.custom_mode, &1.system_status})
             |> Enum.map(&elem(&1, 1)) ==
               [{89, 4, 3}, {217, 4, 3}, {217, 4, 4}, {217, 9, 4}, {217, 9, 3}, {89, 9, 3}]
               |> Enum.reject(&(&1 == {217, 9, 3}))

      assert ["Arming motors", "SIM Hit ground at " <> _speed, "Disarming motors"] = texts(flight)
      assert [{:mode, "GUIDED"}, :armed, :airborne, {:mode, "LAND"}, :landed, :disarmed] = events(flight)
    end

    test "motors take three seconds to get ready, 20 m take about ten, the last 10 m of landing twenty" do
      {v, _log} = flight = :ardupilot |> ready() |> mode([1.0, 4.0]) |> command(400, [1.0]) |> takeoff(20)
      start = Vehicle.seconds(v)
      {v, _log} = flight = until(flight, & &1.airborne, 10)
      assert_in_delta Vehicle.seconds(v) - start, 3.2, 0.5
      {v, _log} = flight = until(flight, &(Vehicle.relative_altitude(&1) > 19), 20)
      assert_in_delta Vehicle.seconds(v) - start, 13.0, 2.0
      {v, _log} = flight = until(mode(flight, [1.0, 9.0]), &(Vehicle.relative_altitude(&1) < 9.9), 20)
      low = Vehicle.seconds(v)
      {v, _log} = until(flight, &(not &1.armed), 40)
      assert_in_delta Vehicle.seconds(v) - low, 22.0, 2.0
    end

    test "armed and not flown it disarms itself after ten seconds" do
      flight = :ardupilot |> ready() |> mode([1.0, 4.0]) |> command(400, [1.0]) |> run(9.5)
      assert vehicle(flight).armed
      flight = run(flight, 1)
      refute vehicle(flight).armed
      assert List.last(texts(flight)) == "Disarming motors"
    end

    test "a position target is flown to, a velocity for GUID_TIMEOUT seconds" do
      target = %M.SetPositionTargetLocalNed{
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0xFF8,
        x: 30.0,
        y: -20.0,
        z: -25.0
      }

      {v, _log} =
        flight = :ardupilot |> flying() |> hear(target) |> until(&(&1.flight.do == :hold), 40) |> run(5)

      assert_in_delta v.kin.n, 30.0, 0.5
      assert_in_delta v.kin.e, -20.0, 0.5
      assert_in_delta v.kin.d, -25.0, 0.5
      assert :arrived in events(flight)

      velocity = %M.SetPositionTargetLocalNed{
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0xFC7,
        vy: 3.0
      }

      {v, _log} = flight |> hear(velocity) |> run(2.9)
      assert_in_delta v.kin.ve, 3.0, 0.1
      {v, _log} = run({v, []}, 8)
      assert_in_delta v.kin.ve, 0.0, 0.1
    end

    test "a target counts in GUIDED only, and one with NaN not at all" do
      target = %M.SetPositionTargetLocalNed{
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0xFF8,
        x: 30.0,
        z: -20.0
      }

      {v, _log} = :ardupilot |> flying() |> mode([1.0, 5.0]) |> hear(target) |> run(5)
      assert_in_delta v.kin.n, 0.0, 0.5
      {v, _log} = :ardupilot |> flying() |> hear(%{target | y: :nan}) |> run(5)
      assert_in_delta v.kin.n, 0.0, 0.5
    end

    test "RTL climbs to RTL_ALT, comes home, lands and disarms" do
      target = %M.SetPositionTargetLocalNed{
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0xFF8,
        x: 50.0,
        z: -8.0
      }

      {v, log} =
        :ardupilot
        |> flying(8)
        |> hear(target)
        |> until(&(&1.flight.do == :hold), 40)
        |> command(20)
        |> until(&(not &1.armed), 120)

      assert {20, 0} in acks({v, log})
      assert_in_delta Kernel.abs(v.kin.n), 0.0, 1.0
      highest = {v, log} |> sent(M.GlobalPositionInt) |> Enum.map(& &1.relative_alt) |> Enum.max()
      assert_in_delta highest, 15_000, 600
    end
  end

  describe "mission" do
    @items [
      %{command: 16, frame: 0, x: 473_977_420, y: 85_455_940, z: 489.0},
      %{command: 22, frame: 3, x: 0, y: 0, z: 20.0},
      %{command: 16, frame: 3, x: 473_979_420, y: 85_455_940, z: 20.0},
      %{command: 178, frame: 3, x: 0, y: 0, z: 0.0, param2: 8.0},
      %{command: 16, frame: 3, x: 473_979_420, y: 85_458_940, z: 25.0},
      %{command: 20, frame: 0, x: 0, y: 0, z: 0.0}
    ]

    setup do
      %{flight: ready(:ardupilot, home: {47.397742, 8.545594, 489.0})}
    end

    test "upload is asked for item by item with MISSION_REQUEST, then acknowledged", %{flight: flight} do
      flight = upload(flight, @items)
      assert flight |> sent(M.MissionRequest) |> Enum.map(& &1.seq) == [0, 1, 2, 3, 4, 5]
      assert [%{type: 0}] = sent(flight, M.MissionAck)
      assert "Flight plan received" in texts(flight)
    end

    test "what is downloaded is what was uploaded, but item 0 is home", %{flight: flight} do
      flight =
        flight
        |> upload(@items)
        |> clear()
        |> hear(%M.MissionRequestList{target_system: 1, target_component: 1})

      assert [%{count: 6}] = sent(flight, M.MissionCount)

      flight =
        Enum.reduce(
          0..5,
          flight,
          &hear(&2, %M.MissionRequestInt{target_system: 1, target_component: 1, seq: &1})
        )

      [home | rest] = sent(flight, M.MissionItemInt)
      assert {home.x, home.y} == {vehicle(flight).home.lat, vehicle(flight).home.lon}

      assert Enum.map(rest, &{&1.command, &1.x, &1.y, &1.z}) ==
               for(i <- tl(@items), do: {i.command, i.x, i.y, i.z})
    end

    test "an error leaves the old plan (W2)", %{flight: flight} do
      flight = flight |> upload(@items) |> clear()
      bad = List.replace_at(@items, 2, %{command: 31_000, frame: 3, x: 0, y: 0, z: 0.0})
      flight = upload(flight, bad)
      assert [%{type: 3} | _later] = sent(flight, M.MissionAck)
      assert length(Plans.items(vehicle(flight).plans, 0)) == 6
    end

    test "wrong sequence, place beyond the globe, too many, another's upload", %{flight: flight} do
      count = %M.MissionCount{target_system: 1, target_component: 1, count: 3}
      item = %M.MissionItemInt{target_system: 1, target_component: 1, seq: 2, command: 16, frame: 3}
      assert [%{type: 13}] = flight |> hear(count) |> hear(item) |> sent(M.MissionAck)

      assert [%{type: 10}] =
               flight |> hear(count) |> hear(%{item | seq: 0, x: 910_000_000}) |> sent(M.MissionAck)

      assert [%{type: 4}] = flight |> hear(%{count | count: 20_000}) |> sent(M.MissionAck)
      assert [%{type: 14}] = flight |> hear(count) |> hear(count, {254, 190}) |> sent(M.MissionAck)
      assert [%{type: 1}] = flight |> hear(item) |> sent(M.MissionAck)
    end

    test "an upload that stalls is asked for again, then given up (W1)", %{flight: flight} do
      flight = flight |> hear(%M.MissionCount{target_system: 1, target_component: 1, count: 3}) |> run(10)
      assert length(sent(flight, M.MissionRequest)) in 7..9
      assert [%{type: 15}] = sent(flight, M.MissionAck)
      assert vehicle(flight).plans.upload == nil
    end

    test "clear and a count of 0 empty the plan (W4)", %{flight: flight} do
      for message <- [
            %M.MissionClearAll{target_system: 1, target_component: 1},
            %M.MissionCount{target_system: 1, target_component: 1, count: 0}
          ] do
        flight = flight |> upload(@items) |> clear() |> hear(message)
        assert [%{type: 0}] = sent(flight, M.MissionAck)
        assert Plans.items(vehicle(flight).plans, 0) == []
      end
    end

    test "flown in AUTO from the air: items reached in order, then RTL to the ground", %{flight: flight} do
      flight =
        flight
        |> upload(@items)
        |> mode([1.0, 4.0])
        |> command(400, [1.0])
        |> takeoff(20)
        |> until(&(&1.landed == :in_air), 30)
        |> clear()
        |> mode([1.0, 3.0])
        |> until(&(not &1.armed), 200)

      assert flight |> sent(M.MissionItemReached) |> Enum.map(& &1.seq) == [1, 2, 4]
      assert "Mission: 2 WP" in texts(flight)
      assert "Reached command #2" in texts(flight)
      assert "Mission: 5 RTL" in texts(flight)
      assert vehicle(flight).mode == "AUTO"
    end

    test "from the ground the mission waits for MISSION_START", %{flight: flight} do
      flight =
        flight
        |> upload(@items)
        |> mode([1.0, 4.0])
        |> command(400, [1.0])
        |> clear()
        |> mode([1.0, 3.0])
        |> run(3)

      refute vehicle(flight).airborne
      flight = flight |> command(300) |> until(& &1.airborne, 10)
      assert {300, 0} in acks(flight)
    end

    test "MISSION_CURRENT counts without home, and tells the state", %{flight: flight} do
      assert [%{total: 0, mission_state: 1} | _more] = flight |> run(1) |> sent(M.MissionCurrent)

      assert %{total: 5, mission_state: 2} =
               flight |> upload(@items) |> run(1) |> sent(M.MissionCurrent) |> List.last()
    end
  end

  describe "parameters" do
    test "the list comes in order with the count; integers are cast to floats (P2)" do
      flight = :ardupilot |> ready() |> hear(%M.ParamRequestList{target_system: 1, target_component: 1})
      values = sent(flight, M.ParamValue)
      count = Params.count(vehicle(flight).params)
      assert Enum.map(values, & &1.param_index) == Enum.to_list(0..(count - 1))
      assert Enum.all?(values, &(&1.param_count == count))
      assert %{param_value: 1500.0, param_type: 6} = Enum.find(values, &(&1.param_id == "RTL_ALT"))
    end

    test "set is answered with the value, ignores the type (P7) and takes effect; index is 65535" do
      set = %M.ParamSet{
        target_system: 1,
        target_component: 1,
        param_id: "RTL_ALT",
        param_value: 3000.0,
        param_type: 9
      }

      flight = :ardupilot |> ready() |> hear(set)
      assert [%{param_value: 3000.0, param_index: 65_535, param_type: 6}] = sent(flight, M.ParamValue)
      assert vehicle(flight).limits.rtl_alt == 30.0
    end

    test "read by name, by index; an unknown name is not answered" do
      read = %M.ParamRequestRead{target_system: 1, target_component: 1, param_index: -1}

      assert [%{param_id: "WPNAV_SPEED", param_value: 1000.0}] =
               :ardupilot |> ready() |> hear(%{read | param_id: "WPNAV_SPEED"}) |> sent(M.ParamValue)

      assert [%{param_index: 3}] =
               :ardupilot |> ready() |> hear(%{read | param_index: 3}) |> sent(M.ParamValue)

      assert :ardupilot |> ready() |> hear(%{read | param_id: "NO_SUCH"}) |> sent(M.ParamValue) == []
    end
  end

  describe "failsafes" do
    test "low battery: text, RTL, critical in the heartbeat; arming is refused afterwards" do
      flight = :ardupilot |> flying() |> handle({:failsafe, :battery, true}) |> run(1.2)
      assert ["Battery 1 is low " <> _volts, "Battery Failsafe"] = texts(flight)
      assert vehicle(flight).mode == "RTL"
      assert flight |> sent(M.Heartbeat) |> List.last() |> Map.fetch!(:system_status) == 5
      flight = flight |> until(&(not &1.armed), 90) |> clear() |> mode([1.0, 4.0]) |> command(400, [1.0])
      assert {400, 4} in acks(flight)
      assert "Arm: Battery failsafe" in texts(flight)
    end

    test "a battery that is flown empty brings the vehicle down by itself" do
      flight = :ardupilot |> flying(20, battery: [capacity_mah: 1400.0]) |> until(&(not &1.armed), 400)
      assert {:failsafe, :battery, true} in events(flight)
      assert {:failsafe, :battery_critical, true} in events(flight) or vehicle(flight).mode == "RTL"
      assert :landed in events(flight)
    end

    test "EKF and GPS failures land, radio and ground station return" do
      for {kind, mode} <- [
            ekf: "LAND",
            gps: "LAND",
            rc: "RTL",
            gcs: "RTL",
            fence: "RTL",
            battery_critical: "LAND"
          ] do
        flight = :ardupilot |> flying() |> handle({:failsafe, kind, true})
        assert {kind, vehicle(flight).mode} == {kind, mode}
        assert {:failsafe, kind, true} in events(flight)
      end
    end

    test "a lost ground station counts only after one was seen, and with FS_GCS_ENABLE (H5)" do
      flight = :ardupilot |> flying() |> heartbeat() |> handle({:set_param, "FS_GCS_ENABLE", 1}) |> run(6)
      assert vehicle(flight).mode == "RTL"
      assert "GCS Failsafe" in texts(flight)
      flight = flight |> heartbeat() |> run(0.1)
      assert "GCS Failsafe Cleared" in texts(flight)

      flight = :ardupilot |> flying() |> run(10)
      assert vehicle(flight).mode == "GUIDED"
    end

    test "on the ground a failsafe disarms" do
      flight =
        :ardupilot |> ready() |> mode([1.0, 4.0]) |> command(400, [1.0]) |> handle({:failsafe, :rc, true})

      refute vehicle(flight).armed
      assert "Radio Failsafe - Disarming" in texts(flight)
    end

    test "the polygon of the fence plan is watched" do
      corner = fn lat, lon -> %{command: 5001, frame: 0, x: lat, y: lon, z: 0.0, param1: 4.0} end

      square = [
        corner.(-353_634_000, 1_491_651_000),
        corner.(-353_634_000, 1_491_654_000),
        corner.(-353_631_000, 1_491_654_000),
        corner.(-353_631_000, 1_491_651_000)
      ]

      north = %M.SetPositionTargetLocalNed{
        target_system: 1,
        coordinate_frame: 1,
        type_mask: 0xFF8,
        x: 40.0,
        z: -20.0
      }

      flight =
        :ardupilot
        |> flying(20, params: %{"FENCE_ENABLE" => 1})
        |> upload(square, 1)
        |> hear(north)
        |> run(10)

      assert {:failsafe, :fence, true} in events(flight)
      assert vehicle(flight).mode == "RTL"
    end
  end
end
