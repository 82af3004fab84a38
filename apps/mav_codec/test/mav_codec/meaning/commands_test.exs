defmodule MavCodec.Meaning.CommandsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Meaning.Commands
  alias MavCodec.Enums.MavCmd

  defp row(name), do: Commands.get(MavCmd.value(:"MAV_CMD_#{name}"))

  test "every MAV_CMD of the definitions has a row, and no row names anything else" do
    defined = for {name, id} <- MavCmd.all(), do: {id, String.replace_prefix("#{name}", "MAV_CMD_", "")}
    assert Enum.sort(defined) == for(row <- Commands.all(), do: {row.id, row.name})
  end

  test "a command that is new has no row, and so no permission" do
    for id <- [1, 5555, 43_999, 60_000, 65_535, 70_000, -1] do
      assert Commands.get(id) == nil
      assert Commands.permission(id) == nil
      refute Commands.question?(id)
      refute Commands.place?(id)
    end
  end

  test "questions need no more than telemetry, and change nothing" do
    questions = for %{class: :question} = row <- Commands.all(), do: row
    assert Enum.all?(questions, &(&1.permission == :telemetry and &1.as_command == :none))

    for name <- ~w(REQUEST_MESSAGE GET_HOME_POSITION GET_MESSAGE_INTERVAL REQUEST_AUTOPILOT_CAPABILITIES
          REQUEST_PROTOCOL_VERSION REQUEST_CAMERA_INFORMATION REQUEST_VIDEO_STREAM_INFORMATION DO_SEND_BANNER),
        do: assert(Commands.question?(row(name).id), name)

    for name <- ~w(SET_MESSAGE_INTERVAL COMPONENT_ARM_DISARM LOGGING_START STORAGE_FORMAT),
        do: refute(Commands.question?(row(name).id), name)
  end

  test "an enumeration, flag or index has to be the integer that it means" do
    for {name, index, good, bad} <- [
          {"COMPONENT_ARM_DISARM", 1, [0.0, 1.0, :nan, {:nan, 0x7FC00001}],
           [0.6, 0.99999994, -1.0, 2.0, 257.0, :infinity]},
          {"COMPONENT_ARM_DISARM", 2, [0.0, 2989.0, 21_196.0, :nan], [21_195.5, 21_196.25, 1.0, 2988.75]},
          {"DO_SET_MODE", 1, [1.0, 129.0, 255.0], [0.5, 256.0, -1.0]},
          {"DO_SET_MODE", 2, [0.0, 7.0], [6.999, -1.0]},
          {"DO_SET_STANDARD_MODE", 1, [0.0, 8.0], [1.5, 9.0, 257.0]},
          {"DO_PAUSE_CONTINUE", 1, [0.0, 1.0], [0.9, 2.0]},
          {"DO_PARACHUTE", 1, [0.0, 1.0, 2.0], [1.99, 258.0, 3.0]},
          {"DO_FLIGHTTERMINATION", 1, [0.0, 1.0], [0.51, 2.0]},
          {"OVERRIDE_GOTO", 1, [0.0, 3.0], [2.5, 4.0]},
          {"OVERRIDE_GOTO", 2, [0.0, 3.0], [2.5, 259.0]},
          {"MISSION_START", 1, [0.0, 12.0], [0.5, -1.0]},
          {"DO_FENCE_ENABLE", 1, [0.0, 1.0, 2.0], [0.4, 3.0, 256.0]},
          {"DO_AUX_FUNCTION", 1, [31.0, 65_535.0], [30.5, 65_567.0]},
          {"DO_AUX_FUNCTION", 2, [0.0, 2.0], [1.5, 3.0]},
          {"DO_MOTOR_TEST", 1, [1.0], [1.5]},
          {"DO_SET_SAFETY_SWITCH_STATE", 1, [0.0, 1.0], [0.5, 2.0]},
          {"DO_ENGINE_CONTROL", 1, [0.0, 1.0], [0.5, 2.0]},
          {"PREFLIGHT_STORAGE", 1, [0.0, 4.0], [1.5, 5.0]},
          {"PREFLIGHT_REBOOT_SHUTDOWN", 1, [0.0, 5.0], [42.0, 1.5]},
          {"DO_JUMP", 2, [-1.0, 100.0], [-2.0, 0.5]},
          {"REQUEST_OPERATOR_CONTROL", 1, [0.0, 1.0], [0.5, 2.0]}
        ] do
      for value <- good,
          do: assert(Commands.check(row(name), %{index => value}) == :ok, inspect({name, value}))

      for value <- bad,
          do: assert({:error, _} = Commands.check(row(name), %{index => value}), inspect({name, value}))
    end

    assert Commands.check(row("COMPONENT_ARM_DISARM"), %{1 => 0.6}) ==
             {:error, "parameter 1 is 0.6, not 0 or 1"}
  end

  test "what is measured may have any value, but none is infinite" do
    assert Commands.check(row("SET_MESSAGE_INTERVAL"), %{1 => 33.0, 2 => 33_333.3}) == :ok
    assert Commands.check(row("NAV_TAKEOFF"), %{1 => -1.0, 4 => :nan, 5 => :nan, 6 => :nan, 7 => 12.5}) == :ok
    assert {:error, _} = Commands.check(row("DO_REPOSITION"), %{5 => :infinity})
  end
end
