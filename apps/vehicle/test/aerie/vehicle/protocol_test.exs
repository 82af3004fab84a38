defmodule Aerie.Vehicle.ProtocolTest do
  use ExUnit.Case, async: true

  import Aerie.CommandSamples

  alias Aerie.Vehicle.Command.Types
  alias Aerie.Vehicle.{Firmware, Protocol}
  alias Aerie.Vehicle.Protocol.{Condition, Step, Vehicle}
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @kinds Firmware.Page.kinds()
  @adapters for name <- Firmware.names(), do: {name, Firmware.of(name)}

  defp steps(autopilot, name, params, more \\ %{}) do
    Protocol.plan(Firmware.of(autopilot), command(name, params), vehicle(autopilot, more))
  end

  defp first(autopilot, name, params \\ %{}, more \\ %{}) do
    {:ok, [step | _others]} = steps(autopilot, name, params, more)
    step
  end

  defp message(autopilot, name, params, more \\ %{}) do
    {:ok, steps} = steps(autopilot, name, params, more)
    [message] = Firmware.of(autopilot).encode(List.last(steps), 0, vehicle(autopilot, more))
    message
  end

  defp params(%M.CommandLong{} = m),
    do: [m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7]

  defp params(%M.CommandInt{} = m), do: [m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z]

  test "each command is a declared gap or has steps, for any parameters, and they are within what MAVLink declares" do
    property =
      :proper.forall(
        {:proper_types.oneof(@adapters), :proper_types.oneof(@kinds), any()},
        fn {{autopilot, protocol}, kind, command} ->
          vehicle = vehicle(autopilot, %{kind: kind})

          case {protocol.gap(command.type, kind), Protocol.plan(protocol, command, vehicle)} do
            {nil, {:ok, steps}} -> Enum.all?(steps, &sound?(&1, protocol, vehicle))
            {nil, {why_not, reason}} when why_not in [:gap, :error] -> reason =~ ~r/\A\w/
            {reason, {:gap, reason}} -> reason =~ ~r/\A\w/
          end
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 3000]) == true, inspect(:proper.counterexample())
  end

  defp sound?(step, protocol, vehicle) do
    release = if step.stream, do: protocol.release(step, vehicle), else: []

    cancel = with {:error, reason} when is_binary(reason) <- protocol.cancel(step, vehicle), do: []

    for message <- protocol.encode(step, 3, vehicle) ++ cancel ++ release do
      assert is_binary(MavCodec.encode(message, system: 237, component: 191))
      declared?(message)
    end

    is_integer(step.within_ms) and is_list(protocol.listens(step)) and match?(%Step{}, step)
  end

  # A reserved parameter is its default, and no other is out of its range (C9).
  defp declared?(%module{command: command} = message) when module in [M.CommandLong, M.CommandInt] do
    for param <- MavCmd.params(command), param.index <= 4 or module == M.CommandLong do
      value = Enum.at(params(message), param.index - 1)

      if param.reserved, do: assert(value == default(param.default), "#{command} #{param.index}")

      if is_number(value) and value != 0.0 do
        # 21196 is beyond nothing, -1 for "as it is" beyond the minimum of some.
        assert param.min == nil or value >= param.min, "#{command} #{param.index}: #{value}"
        assert param.max == nil or value <= param.max, "#{command} #{param.index}: #{value}"
      end
    end
  end

  defp declared?(_message), do: :ok

  defp default(nil), do: 0.0
  defp default(value), do: value

  test "a gap is answered without steps, with a reason" do
    assert {:gap, "PX4 has no relays"} = steps(:px4, "relay", %{relay: 0, on: true})
    assert {:gap, "ArduPlane takes off" <> _} = steps(:ardupilot, "takeoff", %{altitude: 5}, %{kind: "plane"})

    assert {:gap, "Aerie knows how" <> _} =
             Protocol.plan(Firmware.Unknown, command("arm"), vehicle(:ardupilot))
  end

  test "a gap may be of a firmware, of a kind of vehicle, or of a parameter's value" do
    gap = fn autopilot, name, kind -> Firmware.of(autopilot).gap(name, kind) end

    assert [nil, nil, "ArduPilot has no" <> _] =
             for(name <- ~w(arm relay actuator), do: gap.(:ardupilot, name, "copter"))

    assert [nil, nil] = for(name <- ~w(goto set_home), do: gap.(:inav, name, "copter"))

    assert ["Betaflight has" <> _, "Betaflight has" <> _] =
             for(name <- ~w(goto set_home), do: gap.(:betaflight, name, "copter"))

    sensors =
      for %{name: :sensor, values: values} <- Types.fetch!("calibrate").params, sensor <- values, do: sensor

    able = fn autopilot ->
      for sensor <- sensors, {:ok, _steps} <- [steps(autopilot, "calibrate", %{sensor: sensor})], do: sensor
    end

    assert ~w(accelerometer magnetometer) = Enum.sort(able.(:betaflight))
    assert ["compass_motor"] = sensors -- able.(:px4)
    assert ["rc"] = sensors -- able.(:ardupilot)
  end

  test "a mode that the vehicle has not named yet is not a gap; one that it does not have is" do
    for {type, params} <- [{"hold", %{}}, {"rtl", %{}}, {"set_mode", %{mode: "GPS RESCUE"}}] do
      assert {:error, "the vehicle has not said" <> _} = steps(:betaflight, type, params)

      assert {:gap, "this firmware has no mode" <> _} =
               steps(:betaflight, type, params, %{mode_names: %{0 => "ACRO"}})
    end
  end

  test "heights: ArduPilot's above home, PX4's above mean sea level" do
    assert %{frame: 6, z: 20.0} = message(:ardupilot, "goto", %{lat: 1, lon: 2, altitude: 20})

    assert %{frame: 5, z: 20.0} =
             message(:ardupilot, "goto", %{lat: 1, lon: 2, altitude: 20, altitude_reference: "msl"})

    assert %{frame: 11, z: 20.0} =
             message(:ardupilot, "goto", %{lat: 1, lon: 2, altitude: 20, altitude_reference: "terrain"})

    assert %{frame: 5, z: 509.566} = message(:px4, "goto", %{lat: 1, lon: 2, altitude: 20})
    assert %{param7: 20.0} = message(:ardupilot, "takeoff", %{altitude: 20}, %{in_air: false})
    assert %{param7: 509.566} = message(:px4, "takeoff", %{altitude: 20}, %{in_air: false})

    assert {:error, "the height of its home" <> _} =
             steps(:px4, "takeoff", %{altitude: 20}, %{home: nil, in_air: false})

    assert {:error, "it takes no heights" <> _} =
             steps(:px4, "goto", %{lat: 1, lon: 2, altitude: 20, altitude_reference: "terrain"})
  end

  test "what is not given is NaN, and INT32_MAX for a place (C9)" do
    assert params(message(:px4, "set_altitude", %{altitude: 20})) ==
             [-1.0, 1.0, 0.0, :nan, 2_147_483_647, 2_147_483_647, 509.566]

    assert [-1.0, 1.0, +0.0, yaw, 2_147_483_647, 2_147_483_647, :nan] =
             params(message(:px4, "set_yaw", %{yaw: 90, relative: true}))

    assert_in_delta abs(yaw), :math.pi(), 1.0e-9

    assert [:nan, :nan, 0.5, :nan, :nan, :nan, +0.0] =
             params(message(:px4, "actuator", %{actuator: 3, value: 0.5}))
  end

  test "modes: numbers, main and sub modes, standard modes (X4), modes that the vehicle named" do
    assert [1.0, 5.0 | _] = params(message(:ardupilot, "set_mode", %{mode: "loiter"}))
    assert [1.0, 4.0, 5.0 | _] = params(message(:px4, "set_mode", %{standard_mode: "safe_recovery"}))
    assert [1.0, 6.0 | _] = params(message(:ardupilot, "set_mode", %{standard_mode: "safe_recovery"}))

    assert [1.0, 4.0, 12.0 | _] =
             params(message(:px4, "set_mode", %{mode: "My Mode"}, names(%{201_588_736 => "My mode"})))

    assert %{confirm: {:mode, ["My mode"]}} =
             first(:px4, "set_mode", %{mode: "EXTERNAL2"}, names(%{201_588_736 => "My mode"}))

    assert {:error, ~s(PX4 has no mode "GUIDED")} = steps(:px4, "set_mode", %{mode: "GUIDED"})

    assert {:error, "ArduPilot has no mode for" <> _} =
             steps(:ardupilot, "set_mode", %{standard_mode: "cruise"})
  end

  defp names(names), do: %{mode_names: names}

  test "what PX4 would accept and not do, or do later, is refused" do
    for {name, params} <- [
          {"goto", %{lat: 1, lon: 2, altitude: 3}},
          {"set_altitude", %{altitude: 3}},
          {"set_yaw", %{yaw: 3}},
          {"orbit", %{radius: 5}}
        ],
        do: assert({:error, "it is on the ground"} = steps(:px4, name, params, %{in_air: false}))

    assert {:error, "it is not armed" <> _} =
             steps(:px4, "takeoff", %{altitude: 5}, %{armed: false, in_air: false})
  end

  test "ArduPilot's steps before the last are repeated, the dangerous last one is not" do
    assert {:ok,
            [
              %Step{repeat: :safe, confirm: {:mode, ["GUIDED"]}},
              %Step{repeat: :never, confirm: {:in_air, true}}
            ]} =
             steps(:ardupilot, "takeoff", %{altitude: 5}, %{mode: "STABILIZE", in_air: false})
  end

  test "COMMAND_LONG counts its repetitions (C1)" do
    vehicle = vehicle(:px4)
    assert [%{confirmation: 2}] = Firmware.Px4.Adapter.encode(first(:px4, "disarm"), 2, vehicle)
    assert [%{confirmation: 255}] = Firmware.Px4.Adapter.encode(first(:px4, "disarm"), 300, vehicle)
  end

  test "a gimbal's commands are for the component that manages it, or the one that is named" do
    point = %{pitch: -30, yaw: 0}

    for firmware <- [:ardupilot, :px4],
        {params, manager, component} <- [
          {point, nil, nil},
          {point, 1, nil},
          {point, 154, 154},
          {Map.put(point, :component, 191), 154, 191},
          {Map.put(point, :component, 1), 154, nil}
        ] do
      {:ok, steps} = steps(firmware, "gimbal", params, %{gimbal_manager: manager})

      assert {firmware, params, [component]} ==
               {firmware, params, Enum.uniq(for step <- steps, do: step.component)}
    end
  end

  defp ack(step, fields, source \\ {1, 1}, protocol \\ Firmware.Ardupilot.Adapter) do
    [message] = protocol.encode(step, 0, vehicle(:ardupilot))
    protocol.read(step, struct!(%M.CommandAck{command: message.command}, fields), source, vehicle(:ardupilot))
  end

  test "an acknowledgement is ours by command, source and target (C7)" do
    arm = first(:ardupilot, "arm")
    assert ack(arm, target_system: 237, target_component: 191) == :accepted
    assert ack(arm, target_system: 0, target_component: 0) == :accepted
    assert ack(arm, target_system: 255, target_component: 190) == :ignore
    assert ack(arm, target_system: 237, target_component: 190) == :ignore
    assert ack(arm, [command: 176], {1, 1}) == :ignore
    assert ack(arm, [], {1, 100}) == :ignore
    assert ack(arm, [], {2, 1}) == :ignore
    camera = first(:px4, "camera_photo")
    assert ack(camera, [], {1, 100}, Firmware.Px4.Adapter) == :accepted
    assert ack(camera, [], {1, 1}, Firmware.Px4.Adapter) == :ignore
  end

  test "each result of an acknowledgement" do
    arm = first(:ardupilot, "arm")
    assert ack(arm, result: 0) == :accepted
    assert ack(arm, result: 1) == {:busy, "the vehicle answered TEMPORARILY_REJECTED"}
    assert ack(arm, result: 2) == {:refused, :rejected, "the vehicle answered DENIED"}
    assert ack(arm, result: 3) == {:refused, :rejected, "the vehicle answered UNSUPPORTED"}
    assert ack(arm, result: 4, result_param2: 7) == {:refused, :failed, "the vehicle answered FAILED (7)"}
    assert ack(arm, result: 5, progress: 40) == {:progress, 0.4, nil}
    assert ack(arm, result: 5, progress: 255) == {:progress, nil, nil}
    assert ack(arm, result: 6) == :cancelled
    assert ack(arm, result: 10) == {:refused, :rejected, "the vehicle answered NOT_IN_CONTROL"}
    assert ack(arm, result: 99) == {:refused, :failed, "the vehicle answered with result 99"}
  end

  test "COMMAND_INT and COMMAND_LONG stand in for each other, each once, and never with another height (C2)" do
    goto = first(:ardupilot, "goto", %{lat: 1.5, lon: 2, altitude: 20})
    assert {:instead, long} = ack(goto, result: 7)

    assert [%M.CommandLong{command: 192, param5: 1.5, param6: 2.0, param7: 20.0}] =
             Firmware.Ardupilot.Adapter.encode(long, 0, vehicle(:ardupilot))

    assert {:refused, :rejected, _reason} = ack(long, result: 8)

    # Another frame, with the height that belongs to it.
    assert {:instead, amsl} = ack(goto, result: 9)

    assert [%M.CommandInt{frame: 5, z: 509.566}] =
             Firmware.Ardupilot.Adapter.encode(amsl, 0, vehicle(:ardupilot))

    assert {:refused, :rejected, _reason} = ack(amsl, result: 9)
    assert {:refused, :rejected, _reason} = ack(amsl, result: 7)

    arm = first(:ardupilot, "arm")
    assert {:instead, int} = ack(arm, result: 8)

    assert [%M.CommandInt{command: 400, param1: 1.0, x: 0, y: 0}] =
             Firmware.Ardupilot.Adapter.encode(int, 0, vehicle(:ardupilot))

    assert {:refused, :rejected, _reason} = ack(int, result: 9)
  end

  test "PX4 takes the channels of an override as a whole, and gets them so; 0 would not give them back" do
    override = first(:px4, "rc_override", %{channels: [1500, 1500, 1000, 1500], hold: 1})
    assert [] = Firmware.Px4.Adapter.release(override, vehicle(:px4))

    for channels <- [[1500], [1500, 1500, 1000], [0, 0, 0, 0, 0, 0, 2000], [1500, 0, 1000, 1500]] do
      assert {:error, reason} = steps(:px4, "rc_override", %{channels: channels})
      assert reason =~ "together"
      assert {:ok, _steps} = steps(:ardupilot, "rc_override", %{channels: channels})
    end
  end

  test "streams: one takes the place of another, and overrides are given back" do
    override = first(:ardupilot, "rc_override", %{channels: [1500, 0], hold: 2, rate: 20})
    velocity = first(:ardupilot, "setpoint_velocity", %{vx: 1, vy: 0, vz: 0})
    assert override.key == velocity.key
    assert %{hz: 20, ms: 2000} = override.stream
    assert [message] = Firmware.Ardupilot.Adapter.encode(override, 0, vehicle(:ardupilot))

    assert %M.RcChannelsOverride{chan1_raw: 1500, chan2_raw: 65_535, chan8_raw: 65_535, chan9_raw: 0} =
             message

    assert [released] = Firmware.Ardupilot.Adapter.release(override, vehicle(:ardupilot))
    assert %M.RcChannelsOverride{chan1_raw: 0, chan2_raw: 65_535, chan9_raw: 0} = released
    assert [] = Firmware.Ardupilot.Adapter.release(velocity, vehicle(:ardupilot))
    level = first(:px4, "setpoint_attitude", %{roll: 0, pitch: 0, yaw: 0, thrust: 0.5})

    assert [%M.SetAttitudeTarget{q: [1.0, +0.0, +0.0, +0.0], type_mask: 7}] =
             Firmware.Px4.Adapter.encode(level, 0, vehicle(:px4))

    assert [%M.ManualControl{target: 1, x: 500, z: 0}] =
             Firmware.Px4.Adapter.encode(first(:px4, "manual_control", %{pitch: 0.5}), 0, vehicle(:px4))
  end

  test "what a take-off would be refused for after its first step is known before it" do
    for autopilot <- [:ardupilot, :px4], mode <- ["RTL", "GUIDED"] do
      assert {:error, "it is in the air"} = steps(autopilot, "takeoff", %{altitude: 20}, %{mode: mode})
      on_ground = %{mode: mode, in_air: false, armed: false}
      assert {:error, "it is not armed" <> _} = steps(autopilot, "takeoff", %{altitude: 20}, on_ground)
    end

    # What is not known is left to the vehicle.
    assert {:ok, [_mode, _takeoff]} =
             steps(:ardupilot, "takeoff", %{altitude: 20}, %{mode: "RTL", in_air: nil, armed: nil})
  end

  # Rover's and Sub's GCS_MAVLink know no DO_PAUSE_CONTINUE.
  test "a rover, a boat and a submarine do not pause; their missions go on by the mode" do
    for kind <- ~w(rover boat sub) do
      assert {:gap, "this firmware does not pause" <> _} =
               steps(:ardupilot, "mission_pause", %{}, %{kind: kind})

      assert {:error, "its mission is not paused" <> _} =
               steps(:ardupilot, "resume", %{}, %{kind: kind, mode: "AUTO"})

      assert {:ok, [step]} = steps(:ardupilot, "resume", %{}, %{kind: kind, mode: "MANUAL"})
      assert step.confirm == {:mode, ["AUTO"]}
    end
  end

  test "PX4 lands by descending when it has no position, and says in a text that an item is not in its mission" do
    assert {:any, [{:mode, modes}, {:in_air, false}]} = first(:px4, "land").confirm
    assert "AUTO_DESCEND" in modes
    jump = first(:px4, "mission_set_current", %{seq: 99})
    read = &Firmware.of(:px4).read(jump, %M.Statustext{text: &1}, {1, 1}, vehicle(:px4))
    assert {:refused, :rejected, reason} = read.("WPM: WP CURR CMD: Not in list")
    assert reason =~ "Not in list"
    assert read.("Mission: 3 WP") == :ignore
  end

  test "prompts of a calibration, as PX4 and ArduPilot give them" do
    read = fn autopilot, step, message ->
      Firmware.of(autopilot).read(step, message, {1, 1}, vehicle(autopilot))
    end

    text = fn text -> %M.Statustext{text: text} end
    gyro = first(:px4, "calibrate", %{sensor: "gyro"})

    assert read.(:px4, gyro, text.("[cal] calibration started: 2 gyro")) ==
             {:progress, nil, "calibration started: 2 gyro"}

    assert read.(:px4, gyro, text.("[cal] progress <70>")) == {:progress, 0.7, nil}
    assert read.(:px4, gyro, text.("[cal] calibration done: gyro")) == :done

    assert read.(:px4, gyro, text.("[cal] calibration failed: timeout")) ==
             {:failed, "calibration failed: timeout"}

    assert read.(:px4, gyro, text.("Arming denied: calibrating\t")) == :ignore
    accelerometer = first(:ardupilot, "calibrate", %{sensor: "accelerometer"})
    prompt = "Place vehicle level and press any key."
    assert read.(:ardupilot, accelerometer, text.(prompt)) == {:progress, nil, prompt}
    assert read.(:ardupilot, accelerometer, text.("Calibration successful")) == :done
    assert {:failed, _text} = read.(:ardupilot, accelerometer, text.("Calibration FAILED"))
    magnetometer = first(:ardupilot, "calibrate", %{sensor: "magnetometer"})

    assert read.(:ardupilot, magnetometer, %M.MagCalProgress{completion_pct: 30}) ==
             {:progress, 0.3, "magnetometer 0"}

    assert read.(:ardupilot, magnetometer, %M.MagCalReport{cal_status: 4}) == :done
    assert {:failed, _text} = read.(:ardupilot, magnetometer, %M.MagCalReport{cal_status: 5})
    assert Enum.sort(Firmware.Ardupilot.Adapter.listens(magnetometer)) == [77, 191, 192]
  end

  test "a message that was asked for is the end of asking" do
    step = first(:px4, "request_message", %{message_id: 148})
    assert Enum.sort(Firmware.Px4.Adapter.listens(step)) == [77, 148]
    assert Firmware.Px4.Adapter.read(step, %M.AutopilotVersion{}, {1, 1}, vehicle(:px4)) == :done
    assert Firmware.Px4.Adapter.read(step, %M.Heartbeat{}, {1, 1}, vehicle(:px4)) == :ignore
  end

  test "conditions" do
    vehicle = %{vehicle(:px4) | seen: %{mode: 5, in_air: 9}, vtol_state: "MC", mission_seq: 3, boots: 1}

    for {condition, met?} <- [
          {{:armed, true}, true},
          {{:mode, ["AUTO_LAND"]}, false},
          {{:any, [{:mode, ["AUTO_LAND"]}, {:in_air, true}]}, true},
          {{:vtol_state, "MC"}, true},
          {{:mission_seq, 4}, false},
          {{:booted, 0}, true},
          {{:booted, 1}, false},
          {:told, false},
          {{:home, 47.397742, 8.545594, 2}, true},
          {{:home, 47.397842, 8.545594, 2}, false}
        ] do
      assert Condition.met?(condition, vehicle) == met?, inspect(condition)
      assert Condition.describe(condition, vehicle) =~ ~r/\Ait/
    end

    date_line = %{vehicle | home: %{lat: 0.0, lon: -179.99999, alt_msl: 0.0}}
    assert Condition.met?({:home, 0.0, 179.99999, 3}, date_line)
    assert Condition.seen({:any, [{:mode, ["X"]}, {:in_air, true}]}, vehicle) == 9
    assert Condition.seen(:told, vehicle) == nil
    assert Vehicle.flies?(vehicle) and not Vehicle.flies?(%{vehicle | kind: "rover"})
  end

  test "parameters and missions" do
    for {name, encoding, home?} <- [
          {:ardupilot, :c_cast, true},
          {:px4, :bytewise, false},
          {:inav, :bytewise, false},
          {:generic, :c_cast, false}
        ] do
      assert Firmware.traits(name).param_encoding == encoding
      assert Firmware.of(name).home_is_item_0?() == home?
    end
  end
end
