defmodule Aerie.Vehicle.StateTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Events.Detector.{Batteries, Digest}
  alias Aerie.Vehicle.State
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}
  @px4 %M.Heartbeat{type: 2, autopilot: 12, base_mode: 29, custom_mode: 50_593_792, system_status: 3}

  defp ids(battery), do: Enum.map(battery.batteries, & &1.id)

  defp fold(messages, state \\ %State{}) do
    messages
    |> Enum.with_index()
    |> Enum.reduce(state, fn {message, n}, state ->
      {message, at} = with %{} <- message, do: {message, n * @second}
      {state, _groups} = State.apply(state, message.__struct__.id(), message, at)
      state
    end)
  end

  test "what is unknown is nil, never a number" do
    state =
      fold([
        @copter,
        %M.SysStatus{
          voltage_battery: 0xFFFF,
          current_battery: -1,
          battery_remaining: -1,
          drop_rate_comm: 0xFFFF
        },
        %M.GpsRawInt{fix_type: 0, eph: 0xFFFF, epv: 0xFFFF, satellites_visible: 255},
        %M.VfrHud{airspeed: :nan, groundspeed: :infinity, climb: {:nan, 0x7FC00001}, throttle: 0xFFFF},
        %M.GlobalPositionInt{lat: 0, lon: 0, alt: 0, hdg: 0xFFFF, vx: 0x7FFF},
        %M.Attitude{roll: :nan, pitch: 1.0},
        %M.RcChannels{chancount: 3, chan1_raw: 1500, chan2_raw: 0, chan3_raw: 0xFFFF, rssi: 255},
        %M.MissionCurrent{seq: 0, total: 0xFFFF, mission_state: 1},
        %M.BatteryStatus{
          voltages: List.duplicate(0xFFFF, 10),
          current_battery: -1,
          battery_remaining: -1,
          temperature: 0x7FFF,
          current_consumed: -1
        }
      ])

    assert %{voltage: nil, current: nil, remaining: nil, charge_state: nil} = State.data(state, :battery)

    assert [%{voltage: nil, current: nil, temperature: nil, consumed_mah: nil}] =
             State.data(state, :battery).batteries

    assert %{drop_rate: nil} = State.data(state, :health)
    assert %{hdop: nil, vdop: nil, satellites: nil, lat: nil, fix_name: "NO_GPS"} = State.data(state, :gps)

    assert %{airspeed: nil, groundspeed: nil, climb: nil, throttle: nil, vn: nil} =
             State.data(state, :velocity)

    assert %{lat: nil, lon: nil, alt_msl: nil, alt_rel: nil, heading: nil} = State.data(state, :position)
    assert %{roll: nil, pitch: pitch} = State.data(state, :attitude)
    assert_in_delta pitch, 57.29578, 0.0001
    assert State.data(state, :rc) == %{channels: [1500, nil, nil], rssi: nil}
    assert %{total: nil, state: "NO_MISSION"} = State.data(state, :mission)
  end

  test "an impossible value is refused and changes nothing" do
    state = fold([@copter, %M.HomePosition{latitude: 473_977_415, longitude: 85_455_929, altitude: 488_744}])

    assert State.apply(state, 242, %M.HomePosition{latitude: 950_000_000, longitude: 1}, 9) ==
             {:invalid, :home_position}

    assert {:invalid, _} = State.apply(state, 33, %M.GlobalPositionInt{lat: 1, lon: 1_900_000_000}, 9)
    assert {:invalid, _} = State.apply(state, 24, %M.GpsRawInt{lat: -2_000_000_000, lon: 1}, 9)
    assert {:invalid, _} = State.apply(state, 31, %M.AttitudeQuaternion{q1: :nan}, 9)
    assert State.data(state, :home) == %{lat: 47.3977415, lon: 8.5455929, alt_msl: 488.744}
  end

  test "units" do
    state =
      fold([
        @copter,
        %M.GlobalPositionInt{
          time_boot_ms: 7,
          lat: -353_632_610,
          lon: 1_491_652_299,
          alt: 584_090,
          relative_alt: 20_500,
          vx: 150,
          vy: -250,
          vz: -50,
          hdg: 18_011
        },
        %M.SysStatus{voltage_battery: 12_600, current_battery: 1234, battery_remaining: 74, load: 604},
        %M.GpsRawInt{fix_type: 3, eph: 121, satellites_visible: 10, h_acc: 300}
      ])

    assert State.data(state, :position) ==
             %{lat: -35.363261, lon: 149.1652299, alt_msl: 584.09, alt_rel: 20.5, heading: 180.11}

    assert %{vn: 1.5, ve: -2.5, vd: -0.5} = State.data(state, :velocity)
    assert %{voltage: 12.6, current: 12.34, remaining: 0.74} = State.data(state, :battery)
    assert %{load: 0.604} = State.data(state, :health)
    assert %{hdop: 1.21, h_acc: 0.3, fix: 3, fix_name: "3D_FIX"} = State.data(state, :gps)
    assert state.groups.position.at == @second
  end

  test "present, enabled and unhealthy sensors are listed; the pre-arm check is not a sensor" do
    gps = 0x20
    prearm = 0x10000000

    sick = %M.SysStatus{
      onboard_control_sensors_present: gps + prearm + 1,
      onboard_control_sensors_enabled: gps + prearm
    }

    assert %{unhealthy: ["gps"], ready_to_arm: false} = State.data(fold([@copter, sick]), :health)
    healthy = %{sick | onboard_control_sensors_health: gps + prearm}
    assert %{unhealthy: [], ready_to_arm: true} = State.data(fold([@copter, healthy]), :health)
    assert %{ready_to_arm: nil} = State.data(fold([@copter, %M.SysStatus{}]), :health)
  end

  test "PX4's current of -1 A is unknown" do
    assert State.data(fold([@px4, %M.SysStatus{current_battery: -100}]), :battery).current == nil
    assert State.data(fold([@copter, %M.SysStatus{current_battery: -100}]), :battery).current == -1.0
  end

  test "several batteries: each is listed, the worst state counts, and the first one with values is the group's own" do
    cells = fn voltage -> [voltage | List.duplicate(0xFFFF, 9)] end
    blind = %M.BatteryStatus{id: 0, voltages: cells.(0xFFFF), battery_remaining: -1}
    one = %M.BatteryStatus{id: 1, voltages: cells.(16_200), battery_remaining: 50, charge_state: 1}
    two = %M.BatteryStatus{id: 2, voltages: cells.(15_100), battery_remaining: 20, charge_state: 3}
    battery = State.data(fold([@copter, two, one, blind]), :battery)
    assert %{id: 1, voltage: 16.2, remaining: 0.5, charge_state: "CRITICAL"} = battery
    assert [%{id: 0}, %{id: 1, voltage: 16.2}, %{id: 2, voltage: 15.1, remaining: 0.2}] = battery.batteries

    # One that misses a message now and then stays; one that was taken out goes, and its charge state with it.
    assert [0, 1, 2] = fold([@copter, two, one, blind, one, one, blind]) |> State.data(:battery) |> ids()
    without = State.data(fold([@copter, two, blind] ++ List.duplicate(one, 70)), :battery)
    assert {[1], "OK"} = {ids(without), without.charge_state}
  end

  test "SYS_STATUS counts only while no BATTERY_STATUS comes" do
    status = %M.SysStatus{voltage_battery: 12_000, battery_remaining: 36}
    one = %M.BatteryStatus{id: 0, voltages: [11_000 | List.duplicate(0xFFFF, 9)], battery_remaining: 13}
    assert %{id: nil, voltage: 12.0, remaining: 0.36} = State.data(fold([@copter, status]), :battery)

    assert %{id: 0, voltage: 11.0, remaining: 0.13} =
             State.data(fold([@copter, status, one, status]), :battery)

    {state, _groups} = State.apply(fold([@copter, one]), 1, status, 60_000_000)
    assert %{id: nil, voltage: 12.0, remaining: 0.36} = State.data(state, :battery)

    # What only BATTERY_STATUS says is kept for a while, and is not of the present then.
    low = fold([@copter, %{one | charge_state: 2}])
    {state, _groups} = State.apply(low, 1, status, 30 * @second)
    assert %{id: nil, charge_state: "LOW", batteries: [_one]} = State.data(state, :battery)
    {state, _groups} = State.apply(state, 1, status, 90 * @second)
    assert %{remaining: 0.36, charge_state: nil, batteries: nil} = State.data(state, :battery)

    unknown = %{one | voltages: List.duplicate(0xFFFF, 10), battery_remaining: -1}
    assert %{id: nil, remaining: 0.36} = State.data(fold([@copter, status, unknown, status]), :battery)
  end

  test "a battery that stops measuring: its last values are none of the present, and those of SYS_STATUS count again" do
    one = %M.BatteryStatus{id: 0, voltages: [11_000 | List.duplicate(0xFFFF, 9)], battery_remaining: 13}
    blind = %{one | voltages: List.duplicate(0xFFFF, 10), battery_remaining: -1}
    state = fold([@copter, one, blind])
    assert %{id: nil, voltage: nil, remaining: nil, batteries: [%{id: 0}]} = State.data(state, :battery)
    assert %{remaining: nil, batteries: [%{id: 0}]} = Batteries.digest(state)

    status = %M.SysStatus{voltage_battery: 12_000, battery_remaining: 36}
    state = fold([@copter, one, blind, status, blind])
    assert %{id: nil, voltage: 12.0, remaining: 0.36} = State.data(state, :battery)
  end

  test "cells are added up, including those of the extension" do
    many = %M.BatteryStatus{
      voltages: List.duplicate(4000, 10),
      voltages_ext: [4000, 4000, 0, 0],
      battery_remaining: 10
    }

    assert State.data(fold([@copter, many]), :battery).voltage == 48.0
  end

  test "ids of batteries are bounded" do
    state = fold([@copter | for(id <- 0..255, do: %M.BatteryStatus{id: id})])
    assert length(State.data(state, :battery).batteries) == 16
  end

  test "a second choice is used only while the first does not come" do
    assert State.wants?(%State{}, 31, 0)
    state = fold([@copter, %M.Attitude{}])
    refute State.wants?(state, 31, 2 * @second)
    assert State.wants?(state, 31, 4 * @second)
    assert State.wants?(state, 30, 4 * @second)
    refute State.wants?(state, 116, 0)

    half = :math.sqrt(0.5)
    turned = State.data(fold([@copter, %M.AttitudeQuaternion{q1: half, q4: half}]), :attitude)
    assert_in_delta turned.yaw, 90.0, 1.0e-6
  end

  test "MAVLink 1 has no totals in MISSION_CURRENT" do
    assert %{seq: 3, total: nil, state: nil} =
             State.data(fold([@copter, %M.MissionCurrent{seq: 3}]), :mission)
  end

  test "firmware versions" do
    version = fn number -> fold([@copter, %M.AutopilotVersion{flight_sw_version: number, uid: 255}]) end
    assert %{firmware: "4.6.3", uid: "FF"} = version.(67_503_103)
    assert version.(0x01120080).firmware == "1.18.0-beta"
    assert version.(0).firmware == nil
    assert fold([@copter, %M.AutopilotVersion{uid2: <<1, 0::136>>}]).uid == "01" <> String.duplicate("0", 34)
  end

  test "HIGH_LATENCY2 fills all groups (X6); PX4's mode is in its upper half" do
    message = %M.HighLatency2{
      type: 2,
      autopilot: 12,
      custom_mode: 0x0304,
      latitude: 473_977_415,
      longitude: 85_455_929,
      altitude: 500,
      heading: 45,
      groundspeed: 25,
      battery: 80
    }

    state = fold([message])
    assert %{mode: "AUTO_LOITER", armed: nil} = State.data(state, :mode)
    assert %{lat: 47.3977415, alt_msl: 500.0, heading: 90.0} = State.data(state, :position)
    assert %{remaining: 0.8} = State.data(state, :battery)
    assert state.high_latency
    assert State.data(fold([%{message | autopilot: 3, custom_mode: 4}]), :mode).mode == "GUIDED"
    assert {:invalid, _} = State.apply(state, 235, %{message | latitude: 2_000_000_000}, 0)
  end

  test "a snapshot restores the state" do
    state = fold([@copter, %M.SysStatus{voltage_battery: 12_600}])

    snapshot = %Aerie.Vehicle.Snapshot{
      autopilot: :ardupilot,
      vehicle_type: "copter",
      firmware: "4.6.3",
      type: 2,
      groups: state.groups
    }

    restored = State.restore(snapshot)
    assert State.data(restored, :mode) == State.data(state, :mode)
    assert restored.kind == "copter"
  end

  describe "in the air" do
    defp in_air(messages, state \\ %State{}), do: State.data(fold(messages, state), :mode).in_air

    test "is unknown before the heartbeat" do
      assert in_air([%M.ExtendedSysState{landed_state: 2}]) == nil
    end

    test "by EXTENDED_SYS_STATE, also while taking off and landing" do
      armed = %{@px4 | base_mode: 157, system_status: 4}

      for {landed, expected} <- [{1, false}, {2, true}, {3, true}, {4, true}] do
        assert in_air([armed, %M.ExtendedSysState{landed_state: landed}]) == expected
      end
    end

    test "without it by ArduPilot's ACTIVE and STANDBY; in a failsafe as before" do
      armed = %{@copter | base_mode: 0xD1}
      assert in_air([%{armed | system_status: 4}]) == true
      assert in_air([armed]) == false
      assert in_air([%{armed | system_status: 4}, %{armed | system_status: 5}]) == true
      assert in_air([%{armed | system_status: 3}, %{armed | system_status: 5}]) == false
    end

    test "without it for PX4 by height, with hysteresis" do
      armed = %{@px4 | base_mode: 157, system_status: 4}
      at = fn height, down -> %M.GlobalPositionInt{lat: 1, lon: 1, relative_alt: height, vz: down} end
      assert in_air([armed, at.(1000, 0)]) == false
      assert in_air([armed, at.(1600, 0)]) == true
      assert in_air([armed, at.(1600, 0), at.(700, 50)]) == true
      assert in_air([armed, at.(1600, 0), at.(300, 100)]) == true
      assert in_air([armed, at.(1600, 0), at.(300, 10)]) == false
      assert in_air([armed, at.(1600, 0), %{armed | base_mode: 29}]) == false
    end

    test "without a height it is not known, unless it flew" do
      armed = %{@px4 | base_mode: 157, system_status: 4}
      disarmed = %{armed | base_mode: 29}
      up = %M.GlobalPositionInt{lat: 1, lon: 1, relative_alt: 9000}
      assert in_air([disarmed]) == false
      assert in_air([disarmed, armed]) == nil
      assert in_air([disarmed, armed, up]) == true
      assert in_air([disarmed, armed, up, %{up | relative_alt: 0x7FFFFFFF}]) == true
    end

    test "an old EXTENDED_SYS_STATE does not count" do
      armed = %{@copter | base_mode: 0xD1, system_status: 4}
      messages = [{armed, 0}, {%M.ExtendedSysState{landed_state: 1}, @second}]
      assert in_air(messages ++ [{armed, 3 * @second}]) == false
      assert in_air(messages ++ [{armed, 7 * @second}]) == true
    end

    test "never for a rover, whatever it says" do
      rover = %M.Heartbeat{type: 10, autopilot: 3, base_mode: 0x81, system_status: 4}
      assert in_air([rover, %M.ExtendedSysState{landed_state: 2}]) == false
    end
  end

  test "every group has all its keys from its first message on" do
    messages = [
      @copter,
      %M.SysStatus{},
      %M.GlobalPositionInt{},
      %M.Attitude{},
      %M.GpsRawInt{},
      %M.MissionCurrent{}
    ]

    for {group, %{data: data}} <- fold(messages).groups do
      assert Enum.sort(Map.keys(data)) == Enum.sort(State.keys(group))
    end
  end

  # Runs of the bytes that mean "unknown" in most fields, and of those that do not.
  defp payload do
    run = {:proper_types.oneof([0, 255, :proper_types.byte()]), :proper_types.integer(1, 40)}

    :proper_types.oneof([
      :proper_types.binary(),
      :proper_types.bind(
        :proper_types.list(run),
        &for({byte, n} <- &1, into: "", do: :binary.copy(<<byte>>, n)),
        false
      )
    ])
  end

  test "no message, whatever its content, raises or gives a value of the wrong type" do
    ids = Enum.filter(MavCodec.Dialects.All.ids(), &State.wants?(%State{}, &1, 0))

    prop =
      :proper.forall(
        # Few kinds, often the same one again: what was known becomes unknown.
        :proper_types.bind(
          :proper_types.list(:proper_types.oneof(ids)),
          &if(&1 == [], do: [], else: :proper_types.list({:proper_types.oneof(&1), payload()})),
          false
        ),
        fn
          messages ->
            state =
              Enum.reduce(messages, %State{}, fn {id, payload}, state ->
                {:ok, message} = MavCodec.Dialects.All.decode(id, payload)

                case State.apply(state, id, message, 1) do
                  {:invalid, _field} -> state
                  {state, _groups} -> state
                end
              end)

            is_map(Digest.of(state)) and is_map(Digest.beside(state)) and
              is_binary(JSON.encode!(Map.new(state.groups, fn {group, entry} -> {group, entry.data} end)))
        end
      )

    assert :proper.quickcheck(prop, [:quiet, numtests: 3000, max_size: 60]) == true,
           inspect(:proper.counterexample())
  end
end
