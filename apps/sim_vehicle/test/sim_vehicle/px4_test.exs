defmodule SimVehicle.Px4Test do
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Real32}

  describe "boot" do
    test "some parameters come without a request, events start at 65526 and wrap" do
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
    test "a mode is acknowledged twice: accepted at once, then with the true result" do
      assert :px4 |> ready() |> mode([1.0, 6.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 0}]
      assert :px4 |> flying() |> mode([1.0, 6.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 1}]
      assert :px4 |> flying() |> mode([1.0, 3.0]) |> run(0.1) |> acks() == [{176, 0}, {176, 1}]
    end

    test "an unknown main mode is accepted twice and changes nothing; an unknown sub mode is rejected" do
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

    test "a changed value is sent twice and changes the hash; a wrong type and an unknown name are not answered" do
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
    test "are sent again on request; one that is not kept gives an error with the oldest" do
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

    test "loss and return are reported" do
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
