defmodule SimVehicle.ArdupilotFlightTest do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Plans, Vehicle}

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

    test "an upload is requested item by item with MISSION_REQUEST, then acknowledged", %{flight: flight} do
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

    test "a stalled upload is requested again, then given up (W1)", %{flight: flight} do
      flight = flight |> hear(%M.MissionCount{target_system: 1, target_component: 1, count: 3}) |> run(10)
      assert length(sent(flight, M.MissionRequest)) in 7..9
      assert [%{type: 15}] = sent(flight, M.MissionAck)
      assert vehicle(flight).plans.upload == nil
    end

    test "at five times the speed it is not given up sooner: the ground station lives in real time" do
      count = %M.MissionCount{target_system: 1, target_component: 1, count: 3}
      flight = :ardupilot |> ready(speed: 5.0) |> hear(count) |> run(38)
      assert vehicle(flight).plans.upload != nil
      assert [%{type: 15}] = flight |> run(5) |> sent(M.MissionAck)
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

    test "MISSION_CURRENT counts without home, and shows the state", %{flight: flight} do
      assert [%{total: 0, mission_state: 1} | _more] = flight |> run(1) |> sent(M.MissionCurrent)

      assert %{total: 5, mission_state: 2} =
               flight |> upload(@items) |> run(1) |> sent(M.MissionCurrent) |> List.last()
    end
  end
end
