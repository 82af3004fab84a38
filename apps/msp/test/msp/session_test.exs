defmodule Msp.SessionTest do
  use ExUnit.Case, async: true

  import Msp.Test.Controller, only: [betaflight: 0, betaflight: 1, status: 1]

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Frame
  alias Msp.Test.{Controller, Line, Recorded}

  @second 1_000_000

  defp run(answers, seconds, options \\ []),
    do: answers |> Line.open(options) |> Line.run(round(seconds * @second))

  defp command(line, command, params) do
    fields = for {n, value} <- params, do: {:"param#{n}", value * 1.0}
    message = struct!(%M.CommandLong{target_system: 42, target_component: 1, command: command}, fields)
    Line.handle(line, {:mavlink, MavCodec.encode(message, system: 237, component: 191)})
  end

  defp acks(line), do: for({_at, ack} <- Line.told(line, M.CommandAck), do: {ack.command, ack.result})
  defp texts(line), do: for({_at, text} <- Line.told(line, M.Statustext), do: text.text)

  defp requests_at(line, id),
    do: for({at, <<_, _, _, _, ^id, _::binary>>} <- line.written, do: at - 1_000_000_000_000)

  defp requests(line), do: for({_at, <<_, _, _, _, id, _::binary>>} <- Enum.reverse(line.written), do: id)

  describe "who is there" do
    test "a port that speaks MAVLink is never asked (Q3)" do
      heartbeat = MavCodec.encode(%M.Heartbeat{type: 2, autopilot: 3}, system: 1, component: 1)

      line =
        betaflight()
        |> Line.open()
        |> Line.run(900_000)
        |> Line.handle({:bytes, heartbeat})
        |> Line.run(5 * @second)

      assert line.failed =~ "it speaks MAVLink"
      assert line.written == []
    end

    test "nothing is said for a second" do
      line = run(betaflight(), 1.1)
      assert line.written == []

      assert [{1_200_000, "$M<" <> <<0, 1, 1>>}] =
               for({at, bytes} <- run(betaflight(), 1.205).written, do: {at - 1_000_000_000_000, bytes})
    end

    test "silence: three requests, and no more" do
      line = run(fn _bytes, _us -> nil end, 30)
      assert line.failed == "it does not answer MSP"
      assert length(line.written) == 3
    end

    test "a command line that echoes what can be printed of each request" do
      for echo <- ["$M<", "\r\n# $M<"] do
        assert run(fn _bytes, _us -> echo end, 30).failed =~ "line"
      end

      assert run(fn _bytes, _us -> "$M<" end, 30).failed =~ "its command line is open"
    end

    test "a cable that is looped back" do
      assert run(fn bytes, _us -> bytes end, 30).failed =~ "looped back"
    end

    test "a video unit that asks us" do
      ask = Frame.encode(%Frame{id: 101})

      line =
        betaflight() |> Line.open() |> Line.run(1_205_000) |> Line.handle({:bytes, ask}) |> Line.run(@second)

      assert line.failed =~ "asks instead of answering"
    end

    test "something else that talks" do
      assert run(fn _bytes, _us -> "ets Jun  8 2016 00:22:57 rst:0x1 (POWERON_RESET)\r\n" end, 30).failed =~
               "sends console text"
    end

    test "firmware that Aerie cannot use over MSP is named, and asked nothing else" do
      for {api, variant, version, why} <- [
            {{12, 9}, "RTFL", {4, 6, 0}, "Rotorflight"},
            {{1, 42}, "ARDU", {4, 2, 0}, "ArduPilot"},
            {{1, 42}, "INAV", {4, 1, 0}, "port for a video unit"},
            {{1, 39}, "BTFL", {3, 4, 0}, "Betaflight 3.4.0 (API 1.39), which Aerie does not know"},
            {{2, 4}, "INAV", {5, 1, 0}, "iNav 5.1.0, which Aerie does not know"},
            {{1, 46}, "ABCD", {1, 0, 0}, ~s(calls itself "ABCD")}
          ] do
        {major, minor} = api
        {a, b, c} = version

        line =
          run(
            betaflight(%{
              "API_VERSION" => %{protocol: 0, api_major: major, api_minor: minor},
              "FC_VARIANT" => %{variant: variant},
              "FC_VERSION" => %{major_or_year: a, minor_or_month: b, patch: c}
            }),
            10
          )

        assert line.failed =~ why
        assert requests(line) == [1, 2, 3]
      end
    end
  end

  describe "a vehicle" do
    test "comes with its heartbeat, then who it is and what its modes are called" do
      line = run(betaflight(), 2, system: 7)

      assert [{_at, %M.Heartbeat{type: 2, autopilot: 0, base_mode: 1, custom_mode: 0, system_status: 3}} | _] =
               Line.told(line, M.Heartbeat)

      assert [first, second | _] = Line.told(line)
      assert {_, %M.Heartbeat{}} = first

      assert {_,
              %M.ComponentInformationBasic{
                vendor_name: "Betaflight",
                model_name: "racer",
                software_version: "Betaflight 4.5.5 (API 1"
              }} = second

      assert [{_, %M.AutopilotVersion{uid2: <<0, 0, 0, 1, 0, 0, 0, 2, _::binary>>}}] =
               Line.told(line, M.AutopilotVersion)

      modes = for {_at, mode} <- Line.told(line, M.AvailableModes), do: {mode.custom_mode, mode.mode_name}
      assert {1, "ANGLE"} in modes and {46, "GPS RESCUE"} in modes and {27, "FAILSAFE"} in modes
      assert texts(line) == ["Betaflight 4.5.5 (API 1.46)"]
    end

    test "values: degrees to radians, pitch with the nose up, heights and speeds, and what is not known" do
      line = run(betaflight(%{"STATUS_EX" => status(%{mode_flags: 1})}), 3)
      [{_at, attitude} | _] = Line.told(line, M.Attitude)
      assert_in_delta attitude.roll, 12.3 * :math.pi() / 180, 1.0e-6
      assert_in_delta attitude.pitch, 4.5 * :math.pi() / 180, 1.0e-6
      assert_in_delta attitude.yaw, -90 * :math.pi() / 180, 1.0e-6
      assert attitude.rollspeed == :nan
      # No position, as this one has no receiver: the height alone.
      assert [{_, %M.Altitude{altitude_relative: 2.5, altitude_amsl: :nan}} | _] = Line.told(line, M.Altitude)
      assert Line.told(line, M.GlobalPositionInt) == []
      [{_, status} | _] = Line.told(line, M.SysStatus)
      assert %{voltage_battery: 0xFFFF, current_battery: -1, battery_remaining: -1, load: 120} = status
      # A reply that it refuses once is not asked for again.
      assert Enum.count(requests(line), &(&1 == 106)) == 1
    end

    test "a position" do
      gps = %{
        fix: 2,
        satellites: 12,
        lat: 473_977_420,
        lon: 85_455_940,
        altitude: 500,
        ground_speed: 1000,
        course: 900,
        dop: 120
      }

      line = run(betaflight(%{"RAW_GPS" => gps, "STATUS_EX" => status(%{mode_flags: 1})}), 4)

      assert [{_, %M.GpsRawInt{fix_type: 3, lat: 473_977_420, satellites_visible: 12, eph: 120}} | _] =
               Line.told(line, M.GpsRawInt)

      {_, position} = line |> Line.told(M.GlobalPositionInt) |> List.last()

      assert %{
               lat: 473_977_420,
               lon: 85_455_940,
               alt: 500_000,
               relative_alt: 2500,
               vx: 0,
               vy: 1000,
               vz: 30,
               hdg: 27_000
             } = position

      assert {_, %M.Altitude{altitude_relative: 2.5, altitude_amsl: 500.0}} =
               line |> Line.told(M.Altitude) |> List.last()

      # Without a fix it is none, although the numbers are still there.
      line = run(betaflight(%{"RAW_GPS" => %{gps | fix: 0}}), 4)
      assert [{_, %M.GpsRawInt{fix_type: 1, lat: 0, lon: 0, cog: 0xFFFF}} | _] = Line.told(line, M.GpsRawInt)
      assert Line.told(line, M.GlobalPositionInt) == []
    end

    defp heights(line),
      do: for({at, height} <- Line.told(line, M.Altitude), do: {at, height.altitude_relative})

    test "heights of Betaflight are above home only while it is armed: disarmed they are above the sea" do
      # Disarmed between two answers about it, and the height of after that comes before the next one.
      armed? = fn us -> us in (4 * @second)..(9 * @second) end

      answers =
        betaflight(%{
          "STATUS_EX" => fn us -> status(%{mode_flags: if(armed?.(us), do: 1, else: 0)}) end,
          "ALTITUDE" => fn us -> %{altitude: if(armed?.(us), do: 120, else: 48_800), vario: 0} end
        })

      heights = answers |> run(14) |> heights()

      assert heights |> Enum.map(&elem(&1, 1)) |> Enum.dedup() |> Enum.map(&(is_float(&1) and round(&1))) == [
               false,
               1,
               false
             ]

      assert Enum.count(heights, fn {_at, height} -> height != :nan end) >= 8
    end

    test "a position that is cut short has no height" do
      cut = Frame.encode(%Frame{id: 106, direction: :reply, payload: <<2, 14, 1::32-little, 1::32-little>>})
      line = run(betaflight(%{"RAW_GPS" => IO.iodata_to_binary(cut)}), 4)
      assert [_ | _] = Line.told(line, M.GpsRawInt)
      assert Line.told(line, M.GlobalPositionInt) == []
      assert Enum.all?(Line.told(line, M.Altitude), fn {_at, height} -> height.altitude_amsl == :nan end)
    end

    test "without a barometer and without a position it does not know how high it is, whatever it says" do
      for {sensors, answers} <- [
            {0b100001, %{}},
            {0b101001, %{"RAW_GPS" => %{fix: 0, satellites: 3, lat: 1, lon: 1}}}
          ] do
        armed = status(%{mode_flags: 1, sensors: sensors})
        none = %{"ALTITUDE" => %{altitude: 0, vario: 0}, "STATUS_EX" => armed}

        gps =
          for {name, values} <- answers,
              into: %{},
              do: {name, Map.merge(%{altitude: 1, ground_speed: 0, course: 0, dop: 0}, values)}

        line = run(betaflight(Map.merge(none, gps)), 6)
        assert [_, _ | _] = heights(line)
        assert Enum.all?(heights(line), fn {_at, height} -> height == :nan end)
      end
    end

    test "a battery; without cells there is none" do
      battery = %{
        cells: 4,
        capacity: 1500,
        voltage_dv: 168,
        drawn: 300,
        current: 1234,
        state: 1,
        voltage: 1655
      }

      line = run(betaflight(%{"BATTERY_STATE" => battery}), 4)
      {_, sent} = line |> Line.told(M.BatteryStatus) |> List.last()

      assert %{
               voltages: [16_550 | _],
               current_battery: 1234,
               current_consumed: 300,
               battery_remaining: 80,
               charge_state: 2
             } = sent

      assert Line.told(
               run(betaflight(%{"BATTERY_STATE" => %{battery | cells: 0, voltage: 0}}), 4),
               M.BatteryStatus
             ) == []
    end

    test "iNav's mission and emergency landing" do
      nav = fn mode, number ->
        %{mode: mode, state: 5, wp_action: 1, wp_number: number, error: 0, heading_target: 0}
      end

      answers =
        Controller.inav(%{
          "WP_GETINFO" => %{capabilities: 0, max_waypoints: 120, valid: 1, count: 4},
          "NAV_STATUS" => fn us -> if us < 8 * @second, do: nav.(3, 2), else: nav.(15, 2) end
        })

      line = run(answers, 12)

      assert %M.MissionCurrent{seq: 1, total: 4, mission_state: 3} =
               line |> Line.told(M.MissionCurrent) |> Enum.at(3) |> elem(1)

      assert Enum.count(texts(line), &(&1 == "Emergency landing: no position")) == 1
    end

    test "channels in the order of the transmitter: throttle before yaw" do
      channels = for us <- [1100, 1200, 1300, 1400, 1500], do: %{channel: us}
      line = run(betaflight(%{"RC" => %{entries: channels}}), 4)

      assert [
               {_,
                %M.RcChannels{
                  chancount: 5,
                  chan1_raw: 1100,
                  chan3_raw: 1400,
                  chan4_raw: 1300,
                  chan6_raw: 0xFFFF
                }}
               | _
             ] = Line.told(line, M.RcChannels)
    end

    test "what keeps it from being armed is said once for each change, and never while armed" do
      line =
        run(
          betaflight(%{
            "STATUS_EX" => fn us ->
              cond do
                us < 4 * @second -> status(%{arming_disable_flags: 0b100})
                us < 6 * @second -> status(%{arming_disable_flags: 0b10000100})
                us < 8 * @second -> status(%{arming_disable_flags: 0})
                us < 10 * @second -> status(%{mode_flags: 1, arming_disable_flags: 0b100})
                true -> status(%{})
              end
            end
          }),
          12
        )

      assert texts(line) == [
               "Betaflight 4.5.5 (API 1.46)",
               "Arming disabled: RX_FAILSAFE",
               "Arming disabled: RX_FAILSAFE, THROTTLE"
             ]

      [{_, first} | _] = Line.told(line, M.SysStatus)
      prearm = MavCodec.Enums.MavSysStatusSensor.value(:MAV_SYS_STATUS_PREARM_CHECK)
      assert Bitwise.band(first.onboard_control_sensors_enabled, prearm) != 0
      assert Bitwise.band(first.onboard_control_sensors_health, prearm) == 0
    end

    test "a long text goes in chunks that belong together" do
      line = run(betaflight(%{"STATUS_EX" => status(%{arming_disable_flags: 0x3E_FFFF})}), 3)
      chunks = for {_, %{id: id} = text} when id > 0 <- Line.told(line, M.Statustext), do: text
      assert length(chunks) > 2 and length(Enum.uniq_by(chunks, & &1.id)) == 1
      assert Enum.map(chunks, & &1.chunk_seq) == Enum.to_list(0..(length(chunks) - 1))
      assert "Arming disabled: NO_GYRO, FAILSAFE, RX_FAILSAFE" <> _ = Enum.map_join(chunks, & &1.text)
    end

    test "no heartbeat without a reply: a vehicle that falls silent is not made up" do
      line = run(betaflight(%{"STATUS_EX" => fn us -> if us < 5 * @second, do: status(%{}) end}), 20)
      assert line |> Line.told(M.Heartbeat) |> List.last() |> elem(0) < 5.1 * @second
    end
  end

  describe "a line that fails" do
    test "is asked again who is there, with the boxes that it has then" do
      answers =
        betaflight(%{
          "BOXIDS" => fn us ->
            if us < 5 * @second, do: %{entries: [%{id: 0}, %{id: 1}]}, else: %{entries: [%{id: 0}, %{id: 46}]}
          end,
          "STATUS_EX" => status(%{mode_flags: 0b10})
        })

      line =
        run(fn bytes, us -> if us in (5 * @second)..(8 * @second), do: nil, else: answers.(bytes, us) end, 14)

      assert for({_, %{custom_mode: mode}} <- Line.told(line, M.Heartbeat), do: mode) |> Enum.dedup() == [
               1,
               46
             ]

      refute line.failed
    end

    test "a restart shows in Betaflight's first seconds, which it does not arm in: its clock begins again" do
      status = fn us ->
        status(%{arming_disable_flags: if(us in (9 * @second)..(13 * @second), do: 0x200, else: 0)})
      end

      answers = betaflight(%{"STATUS_EX" => status})

      line =
        run(fn bytes, us -> if us in (7 * @second)..(9 * @second), do: nil, else: answers.(bytes, us) end, 20)

      boots = for {at, %{time_boot_ms: ms}} <- Line.told(line, M.Attitude), do: {at, ms}
      {_, before} = boots |> Enum.filter(fn {at, _} -> at < 7 * @second end) |> List.last()
      {_, behind} = List.last(boots)
      assert before > 5000 and behind < 12_000
    end

    test "is counted: damaged replies and noise between them" do
      answers = betaflight()

      noisy = fn bytes, us ->
        case answers.(bytes, us) do
          <<head::binary-size(7), byte, rest::binary>> when us > 3 * @second ->
            "ab" <> head <> <<Bitwise.bxor(byte, 4)>> <> rest

          reply ->
            reply
        end
      end

      line = run(noisy, 4)
      assert line.counted.crc_errors > 2 and line.counted.resync_bytes > 2 * line.counted.crc_errors
    end

    test "its clock is monotonic: it may be far below zero" do
      line = betaflight() |> Line.open(now: -576_460_752_303_423_488) |> Line.run(5 * @second)
      refute line.failed
      assert length(line.told) > 20
      assert length(line.written) > 40
    end

    test "replies that take longer than a second are waited for, once that is known" do
      for delay <- [1_300_000, 900_000, 2_000_000] do
        line = run(betaflight(), 60, delay: delay)
        refute line.failed
        beats = for {at, _} <- Line.told(line, M.Heartbeat), at > 30 * @second, do: at
        # One request after the other, each second one for the sign of life.
        assert length(beats) >= div(30 * @second, 2 * delay + 300_000)
        # It is not asked again and again who it is.
        assert Enum.count(requests(line), &(&1 == 2)) <= 3
      end
    end

    test "a line that becomes slow is learned while its replies come late" do
      slow = fn _bytes, _answer, now ->
        if now - 1_000_000_000_000 > 10 * @second, do: 1_300_000, else: 10_000
      end

      line = run(betaflight(), 90, delay: slow)
      beats = for {at, _} <- Line.told(line, M.Heartbeat), at > 40 * @second, do: at
      assert length(beats) >= 5
      late = for at <- requests_at(line, 2), at > 40 * @second, do: at
      assert late == []
    end

    test "a late reply is not taken for another's, and half a frame holds nothing up" do
      answers = betaflight()
      # Each tenth reply comes after its time; each seventh is cut.
      counter = :counters.new(1, [])

      odd = fn bytes, us ->
        :counters.add(counter, 1, 1)

        case :counters.get(counter, 1) do
          n when us > 3 * @second and rem(n, 7) == 0 -> binary_slice(answers.(bytes, us), 0..-4//1)
          _n -> answers.(bytes, us)
        end
      end

      line = run(odd, 30)
      refute line.failed
      late = Line.told(line, M.Attitude)
      assert length(late) > 40

      assert Enum.all?(late, fn {_at, attitude} ->
               attitude == %{hd_value(late) | time_boot_ms: attitude.time_boot_ms}
             end)
    end
  end

  defp hd_value([{_at, first} | _]), do: first

  describe "requests of clients" do
    test "for a message, its interval, and the names of modes" do
      line = run(betaflight(), 3) |> command(512, %{1 => 148})
      assert {512, 0} in acks(line)
      assert length(Line.told(line, M.AutopilotVersion)) == 2
      line = command(line, 512, %{1 => 435, 2 => 2})
      assert {_, %M.AvailableModes{mode_index: 2}} = line |> Line.told(M.AvailableModes) |> List.last()
      assert {512, 3} in acks(command(line, 512, %{1 => 9999}))

      before = length(Line.told(line, M.Attitude))
      line = line |> command(511, %{1 => 30, 2 => 50_000}) |> Line.run(2 * @second)
      assert {511, 0} in acks(line)
      assert (length(Line.told(line, M.Attitude)) - before) in 35..42
      line = command(line, 510, %{1 => 30})

      assert [{_, %M.MessageInterval{message_id: 30, interval_us: 50_000}}] =
               Line.told(line, M.MessageInterval)

      # The default is the usual rate again.
      line = command(line, 511, %{1 => 30, 2 => 0}) |> command(510, %{1 => 30})
      assert {_, %{interval_us: 200_000}} = line |> Line.told(M.MessageInterval) |> List.last()
    end

    test "for a message that is not made here: refused, not unknown, so that nobody asks for groups instead" do
      line = run(betaflight(), 3) |> command(511, %{1 => 74, 2 => 500_000})
      assert List.last(acks(line)) == {511, 2}
    end

    test "for two messages of one reply: each has its own rate, and none of both" do
      answers =
        betaflight(%{
          "RAW_GPS" => %{
            fix: 2,
            satellites: 12,
            lat: 1,
            lon: 1,
            altitude: 5,
            ground_speed: 0,
            course: 0,
            dop: 90
          }
        })

      line =
        answers
        |> run(3)
        |> command(511, %{1 => 24, 2 => 1_000_000})
        |> command(511, %{1 => 33, 2 => 250_000})

      count = fn line, module -> length(Line.told(line, module)) end
      later = Line.run(line, 10 * @second)
      assert (count.(later, M.GpsRawInt) - count.(line, M.GpsRawInt)) in 9..11
      assert (count.(later, M.GlobalPositionInt) - count.(line, M.GlobalPositionInt)) in 36..41
      none = later |> command(511, %{1 => 33, 2 => -1}) |> command(510, %{1 => 33})
      assert {_, %{interval_us: -1}} = none |> Line.told(M.MessageInterval) |> List.last()
      last = Line.run(none, 10 * @second)
      assert count.(last, M.GlobalPositionInt) == count.(later, M.GlobalPositionInt)
      assert (count.(last, M.GpsRawInt) - count.(later, M.GpsRawInt)) in 9..11
    end

    test "for a heartbeat now and then: changes of the mode show as soon as ever" do
      line =
        run(betaflight(), 3) |> command(511, %{1 => 0, 2 => 5_000_000}) |> command(511, %{1 => 1, 2 => -1})

      asked = fn line -> line |> requests() |> Enum.count(&(&1 == 150)) end
      later = Line.run(line, 10 * @second)
      assert (asked.(later) - asked.(line)) in 48..51
      assert length(Line.told(later, M.Heartbeat)) > 10
    end

    test "to others, and impossible numbers, change nothing" do
      line = run(betaflight(), 3)

      other =
        MavCodec.encode(%M.CommandLong{target_system: 41, target_component: 1, command: 246, param1: 1.0},
          system: 255,
          component: 190
        )

      line = Line.handle(line, {:mavlink, other})
      assert acks(line) == []

      line =
        Line.handle(
          line,
          {:mavlink,
           MavCodec.encode(%M.CommandLong{target_system: 42, command: 512, param1: :nan},
             system: 255,
             component: 190
           )}
        )

      assert acks(line) == [{512, 3}]
      assert [] == line |> Line.handle({:mavlink, :rand.bytes(500)}) |> Line.told(M.ParamValue)
    end

    test "to restart it: acknowledged when it has said so, refused while it is armed" do
      line = run(betaflight(%{"REBOOT" => %{mode: 0}}), 3) |> command(246, %{1 => 1}) |> Line.run(@second)
      assert {246, 0} in acks(line)
      assert 68 in requests(line)

      armed = betaflight(%{"REBOOT" => %{mode: 0}, "STATUS_EX" => status(%{mode_flags: 1})})
      line = run(armed, 3) |> command(246, %{1 => 1}) |> Line.run(@second)
      assert acks(line) == [{246, 2}]
      refute 68 in requests(line)
      assert "REBOOT refused: it is armed" in texts(line)
      # Into a boot loader: never.
      assert {246, 3} in acks(command(line, 246, %{1 => 3}))
    end

    test "what the flight controller refuses is FAILED; what it does not answer is not acknowledged" do
      line = run(betaflight(%{"EEPROM_WRITE" => :refused}), 3) |> command(245, %{1 => 1}) |> Line.run(@second)
      assert acks(line) == [{245, 4}]
      line = run(betaflight(%{"EEPROM_WRITE" => nil}), 3) |> command(245, %{1 => 1}) |> Line.run(8 * @second)
      assert acks(line) == []
      # Once: a write is not repeated.
      assert Enum.count(requests(line), &(&1 == 250)) == 1
    end

    test "what is repeated while it is being done is not done twice" do
      line =
        run(betaflight(%{"ACC_CALIBRATION" => :done}), 3)
        |> command(241, %{5 => 1})
        |> command(241, %{5 => 1})
        |> Line.run(@second)

      assert Enum.sort(acks(line)) == [{241, 0}, {241, 5}]
      assert Enum.count(requests(line), &(&1 == 205)) == 1
    end
  end

  describe "the real ones" do
    test "Betaflight 4.5.5: armed, ANGLE, disarmed as its recording says" do
      line = run(Recorded.answers("betaflight_4.5.5", 0.0), 62)

      beats =
        for {at, beat} <- Line.told(line, M.Heartbeat),
            do: {at / @second, beat.base_mode, beat.custom_mode, beat.system_status}

      changes = Enum.dedup_by(beats, fn {_at, base, mode, status} -> {base, mode, status} end)
      # 22:46:20.540 armed, 28.490 ANGLE, 39.626 disarmed; the first request was at 22:45:51.939.
      assert [{_, 1, 0, 3}, {armed, 129, 0, 4}, {angle, 129, 1, 4}, {disarmed, 1, 1, 3}] = changes
      assert_in_delta armed, 28.6, 0.7
      assert_in_delta angle, 36.55, 0.7
      assert_in_delta disarmed, 47.7, 0.7
      assert Enum.any?(Line.told(line, M.Attitude), fn {_at, attitude} -> abs(attitude.roll) > 0.2 end)
    end

    test "Betaflight 4.5.5: 250 m above the sea are not a height above home, before it is armed and after" do
      line = run(Recorded.answers("betaflight_4.5.5", 0.0), 62)
      known = for {at, height} <- heights(line), height != :nan, do: {at / @second, height}
      assert {first, low} = hd(known)
      assert first > 28.5 and low < 6
      assert {last, _height} = List.last(known)
      assert last < 47.8
      assert Enum.all?(known, fn {_at, height} -> abs(height) < 11.1 end)

      assert {_at, 11.01} =
               Enum.max_by(known, &elem(&1, 1)) |> then(fn {at, height} -> {at, Float.round(height, 2)} end)
    end

    test "iNav 9.0.0: what it is, its state and its home" do
      line = run(Recorded.answers("inav_9.0.0", 0.0), 20)
      refute line.failed
      assert ["iNav 9.0.0" | _] = texts(line)

      # Again after ten seconds, for those who were not there.
      assert [{_, %M.ComponentInformationBasic{vendor_name: "iNav"} = identity}, {_, identity}] =
               Line.told(line, M.ComponentInformationBasic)

      assert length(Line.told(line, M.Heartbeat)) > 15
      assert length(Line.told(line, M.SysStatus)) > 15
    end
  end
end
