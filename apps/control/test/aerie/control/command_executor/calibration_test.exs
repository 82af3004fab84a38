defmodule Aerie.Control.CommandExecutor.CalibrationTest do
  @moduledoc "What ends a calibration: each firmware and each sensor in its own way, or not at all."
  use ExUnit.Case, async: true

  import Aerie.CommandSamples

  alias Aerie.Control.CommandExecutor.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @source {1, 1}

  defp core(autopilot) do
    seen = %{mode: 0, in_air: 0}
    Core.new(%{vehicle(autopilot, %{armed: false, in_air: false}) | seen: seen})
  end

  defp submit(core, name, at, params \\ %{}) do
    Core.handle(core, {:submit, command(name, params, id: name), at + 60 * @second, at})
  end

  defp hear(core, message, at), do: Core.handle(core, {:message, message, @source, at})

  defp ack(core, result, at, command \\ 241),
    do: hear(core, %M.CommandAck{command: command, result: result}, at)

  defp text(core, text, at), do: hear(core, %M.Statustext{text: text}, at)
  defp sent(actions), do: for({:send, messages, _id} <- actions, message <- messages, do: message)
  defp results(actions), do: for({:result, result} <- actions, do: {result.id, result.status})
  defp reason(actions), do: Enum.find_value(actions, &(elem(&1, 0) == :result and elem(&1, 1).reason))

  defp until(core, at, actions \\ []) do
    case Core.wake_at(core) do
      wake when wake != nil and wake <= at ->
        {core, more} = Core.handle(core, {:tick, wake})
        until(core, at, actions ++ more)

      _later ->
        {core, actions}
    end
  end

  defp calibrating(autopilot, sensor) do
    {core, [_sent]} = submit(core(autopilot), "calibrate", 1, %{sensor: sensor})
    {core, []} = ack(core, 0, @second)
    core
  end

  describe "ArduPilot" do
    test "the accelerometer's is refused, with what helps, until the vehicle has told its end or was rebooted" do
      core = calibrating(:ardupilot, "accelerometer")
      {_core, actions} = submit(core, "calibrate_cancel", 2 * @second)
      assert results(actions) == [{"calibrate_cancel", :rejected}]
      assert reason(actions) =~ "reboot"

      assert {_core, [{:not_cancelled, "calibrate", reason}]} =
               Core.handle(core, {:cancel, "calibrate", 2 * @second})

      assert reason =~ "calibrate_position"

      {over, actions} = text(core, "Calibration successful", 9 * @second)
      assert results(actions) == [{"calibrate", :completed}]
      {_core, actions} = submit(over, "calibrate_cancel", 10 * @second)
      assert [%M.CommandAck{}, %M.CommandLong{command: 42_426}] = sent(actions)

      # It said nothing more for a long time: it still waits.
      {silent, actions} = until(core, 400 * @second)
      assert results(actions) == [{"calibrate", :timeout}]
      {_core, actions} = submit(silent, "calibrate_cancel", 401 * @second)
      assert results(actions) == [{"calibrate_cancel", :rejected}]

      {rebooted, _actions} = Core.handle(core, {:observed, %{boots: 1}, [:mode], 5 * @second})
      {_core, actions} = submit(rebooted, "calibrate_cancel", 6 * @second)
      assert [_ack, _cancel] = sent(actions)
    end

    test "the one of compass and motors ends by an acknowledgement, and is over when the vehicle is disarmed" do
      core = calibrating(:ardupilot, "compass_motor")
      {core, []} = Core.handle(core, {:observed, %{armed: true}, [:mode], 2 * @second})
      {core, actions} = submit(core, "calibrate_cancel", 3 * @second)
      assert [%M.CommandAck{command: 241, target_system: 1}] = sent(actions)
      # The link lost it.
      {core, actions} = until(core, 6 * @second)
      assert [%M.CommandAck{} | _again] = sent(actions)
      {core, actions} = text(core, "Failed", 6 * @second)
      assert results(actions) == [{"calibrate", :failed}]
      {core, actions} = Core.handle(core, {:observed, %{armed: false}, [:mode], 7 * @second})
      assert results(actions) == [{"calibrate_cancel", :completed}]
      assert Core.size(core) == 0

      core = calibrating(:ardupilot, "compass_motor")
      {_core, actions} = Core.handle(core, {:cancel, "calibrate", 2 * @second})
      assert [%M.CommandAck{command: 241}] = sent(actions)
    end

    test "an armed vehicle that ignores it is not a success" do
      core = calibrating(:ardupilot, "compass_motor")
      {core, []} = Core.handle(core, {:observed, %{armed: true}, [:mode], 2 * @second})
      {core, _sent} = submit(core, "calibrate_cancel", 3 * @second)
      {core, _again} = until(core, 5 * @second)
      {core, []} = Core.handle(core, {:observed, %{armed: true}, [:mode], 5 * @second})
      {_core, actions} = until(core, 40 * @second)
      assert [{"calibrate_cancel", status}] = results(actions)
      assert status != :completed
    end

    test "the magnetometers' by its command" do
      {_core, actions} = :ardupilot |> calibrating_magnetometer() |> submit("calibrate_cancel", 3 * @second)
      assert [%M.CommandLong{command: 42_426}] = sent(actions)
    end

    defp calibrating_magnetometer(autopilot) do
      {core, [_sent]} = submit(core(autopilot), "calibrate", 1, %{sensor: "magnetometer"})
      {core, []} = ack(core, 0, @second, 42_424)
      core
    end
  end

  describe "PX4" do
    test "is asked until it says so; its answers are not the result of either" do
      core = calibrating(:px4, "accelerometer")
      {core, actions} = submit(core, "calibrate_cancel", 2 * @second)
      assert [%M.CommandLong{command: 241, param1: +0.0, param5: +0.0}] = sent(actions)
      {core, []} = ack(core, 1, 2_020_000)
      # Another command came before it looked.
      {core, actions} = until(core, 6 * @second)
      assert [%M.CommandLong{command: 241, confirmation: 1} | _more] = sent(actions)
      {core, []} = ack(core, 1, 6 * @second)
      {core, actions} = text(core, "[cal] calibration cancelled", 7 * @second)
      assert Enum.sort(results(actions)) == [{"calibrate", :cancelled}, {"calibrate_cancel", :completed}]

      # And what comes later is taken.
      {_core, actions} = submit(core, "arm", 9 * @second)
      assert [%M.CommandLong{command: 400}] = sent(actions)
    end

    test "of somebody else, of none, and while it is armed" do
      {core, [_sent]} = submit(core(:px4), "calibrate_cancel", 1)
      {core, []} = ack(core, 1, @second)
      {_core, actions} = text(core, "[cal] calibration cancelled", 2 * @second)
      assert results(actions) == [{"calibrate_cancel", :completed}]

      {core, [_sent]} = submit(core(:px4), "calibrate_cancel", 1)
      {_core, actions} = ack(core, 0, @second)
      assert results(actions) == [{"calibrate_cancel", :accepted}]

      {core, _actions} = Core.handle(core(:px4), {:observed, %{armed: true}, [:mode], 1})
      {_core, actions} = submit(core, "calibrate_cancel", 2)
      assert results(actions) == [{"calibrate_cancel", :rejected}]
    end

    test "a calibration that is cancelled by its id is asked to stop until it says so" do
      core = calibrating(:px4, "accelerometer")
      {core, [_first]} = Core.handle(core, {:cancel, "calibrate", 2 * @second})
      {core, actions} = until(core, 13 * @second)
      assert [%M.CommandLong{command: 241}, %M.CommandLong{command: 241}] = sent(actions)
      {_core, actions} = text(core, "[cal] calibration cancelled", 14 * @second)
      assert results(actions) == [{"calibrate", :cancelled}]
    end
  end
end
