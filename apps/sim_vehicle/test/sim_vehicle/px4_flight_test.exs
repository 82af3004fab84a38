defmodule SimVehicle.Px4FlightTest do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M

  @home {47.397742, 8.545594, 489.0}
  @items [
    %{command: 22, frame: 6, x: 473_977_420, y: 85_455_940, z: 12.0, param4: :nan},
    %{command: 16, frame: 6, x: 473_979_420, y: 85_455_940, z: 15.0, param4: :nan},
    %{command: 178, frame: 2, x: 0, y: 0, z: 0.0, param2: 8.0},
    %{command: 16, frame: 6, x: 473_979_420, y: 85_458_940, z: 15.0, param4: :nan},
    %{command: 20, frame: 2, x: 0, y: 0, z: 0.0}
  ]

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

    test "a height below the clearance (10 m above the sea, as MAVProxy asks) is raised to it, and reported" do
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
      assert_in_delta SimVehicle.Physics.Kinematics.distance(v.kin, 22.26, 0.0), 8.0, 3.0
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

    test "is requested with MISSION_REQUEST_INT and acknowledged with an opaque id (W7)", %{flight: flight} do
      assert [%{total: 65_535, mission_state: 1} | _more] = flight |> run(2) |> sent(M.MissionCurrent)
      flight = upload(flight, @items)
      assert flight |> sent(M.MissionRequestInt) |> Enum.map(& &1.seq) == [0, 1, 2, 3, 4]
      assert [%{type: 0, opaque_id: id}] = sent(flight, M.MissionAck)
      assert id != 0
      list = %M.MissionRequestList{target_system: 1, target_component: 1}
      assert [%{count: 5, opaque_id: ^id}] = flight |> hear(list) |> sent(M.MissionCount)

      assert %{total: 5, mission_state: 2, mission_id: ^id} =
               flight |> run(2) |> sent(M.MissionCurrent) |> List.last()
    end

    test "refused: a command (3), a frame (2), too many (4); out of sequence is requested again", %{
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

    test "accepted and then found infeasible, which only an event reports", %{flight: flight} do
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

    test "flown from the ground: reached items are repeated, the RTL item changes the mode", %{
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
end
