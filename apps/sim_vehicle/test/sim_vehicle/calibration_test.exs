defmodule SimVehicle.CalibrationTest do
  @moduledoc "What the firmwares do while they calibrate, and what ends that."
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.Firmware.Ardupilot.Calibration

  @accelerometer [0.0, 0.0, 0.0, 0.0, 1.0]
  @compass_motor [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]

  defp ack(flight, command, result), do: hear(flight, %M.CommandAck{command: command, result: result})

  # libraries/AP_AccelCal/AP_AccelCal.cpp: update, gcs_vehicle_position, handle_command_ack
  test "ArduPilot's accelerometer goes on by positions and by some acknowledgements, and is not cancelled" do
    flight =
      :ardupilot |> ready() |> command(241, @accelerometer) |> command(42_426) |> ack(241, 0) |> ack(3, 0)

    assert "Place vehicle level and press any key." in texts(flight)
    assert Calibration.running(vehicle(flight)) == {:accelerometer, 1}
    flight = flight |> command(42_429, [1.0]) |> ack(0, 1)
    assert Calibration.running(vehicle(flight)) == {:accelerometer, 3}
    flight = Enum.reduce(3..6, flight, &command(&2, 42_429, [&1 * 1.0]))
    assert "Calibration successful" in texts(flight)
    assert Calibration.running(vehicle(flight)) == nil
  end

  # ArduCopter/compassmot.cpp: mavlink_compassmot; GCS_MAVLINK_Copter::handle_command_ack
  test "ArduCopter calibrates compass and motors armed, until any acknowledgement comes" do
    flight = :ardupilot |> ready() |> command(241, @compass_motor) |> run(2)
    assert vehicle(flight).armed
    held = flight |> command(400, [0.0, 21_196.0]) |> command(246, [1.0]) |> command(42_426) |> run(30)
    assert vehicle(held).armed
    over = ack(held, 241, 0)
    refute vehicle(over).armed
    assert "Failed" in texts(over)
    assert {400, 0} in acks(command(over, 400, [0.0]))
  end

  # src/modules/commander/calibration_routines.cpp: calibrate_cancel_check
  test "PX4 is busy while it calibrates, and sees a cancellation only if no other command follows it" do
    flight = :px4 |> ready() |> command(241, @accelerometer) |> run(1) |> command(241)
    assert acks(flight) == [{241, 0}, {241, 1}]
    missed = flight |> command(511, [245.0, 500_000.0]) |> run(6)
    refute "[cal] calibration cancelled" in texts(missed)
    assert "[cal] calibration cancelled" in (missed |> heartbeat() |> command(241) |> run(3) |> texts())
  end
end
