defmodule SimVehicle.ArdupilotTest do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias Protocols.Params.Listing

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

    test "EXTENDED_SYS_STATE comes only on request" do
      flight = :ardupilot |> boot() |> run(5)
      assert sent(flight, M.ExtendedSysState) == []
      flight = flight |> command(511, [245.0, 500_000.0]) |> run(2)
      assert {511, 0} in acks(flight)
      assert length(sent(flight, M.ExtendedSysState)) in 3..4
    end
  end

  test "its logs are not listed while it is armed" do
    request = %M.LogRequestList{target_system: 1, target_component: 1, start: 0, end: 0xFFFF}
    assert [%M.LogEntry{}] = :ardupilot |> ready(logs: ["log"]) |> hear(request) |> sent(M.LogEntry)
    assert :ardupilot |> flying(20, logs: ["log"]) |> hear(request) |> sent(M.LogEntry) == []
  end

  describe "refusals" do
    test "takeoff while disarmed is 4 FAILED, an unknown command 3 UNSUPPORTED" do
      flight = :ardupilot |> ready() |> takeoff(20) |> command(31_999)
      assert acks(flight) == [{22, 4}, {31_999, 3}]
    end

    test "the acknowledgement is addressed to the requester" do
      [ack] = :ardupilot |> ready() |> command(31_999) |> sent(M.CommandAck)
      assert {ack.target_system, ack.target_component} == {255, 190}
    end

    test "a command for another system is ignored, one for an unknown component of this system is not" do
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

    test "an unknown mode, and a mode without the custom flag" do
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

  describe "parameters" do
    test "the list comes in order with the count; integers are cast to floats (P2)" do
      flight =
        :ardupilot |> ready() |> hear(%M.ParamRequestList{target_system: 1, target_component: 1}) |> run(0.5)

      values = sent(flight, M.ParamValue)
      count = Listing.count(vehicle(flight).params.listing)
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
