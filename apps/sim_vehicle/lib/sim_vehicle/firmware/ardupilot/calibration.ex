defmodule SimVehicle.Firmware.Ardupilot.Calibration do
  @moduledoc """
  PREFLIGHT_CALIBRATION as ArduCopter does it.

  The accelerometer's (`AP_AccelCal`) asks for six positions, each confirmed by ACCELCAL_VEHICLE_POS or by a COMMAND_ACK of a command
  up to 6 with TEMPORARILY_REJECTED, and nothing that a ground station sends cancels it. The one of compass and motors
  (`Copter::mavlink_compassmot`) holds the main loop, armed, until any COMMAND_ACK comes.
  """

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Services.Command

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @failed MavResult.value(:MAV_RESULT_FAILED)
  @positions {"level", "on its LEFT side", "on its RIGHT side", "nose DOWN", "nose UP", "on its BACK"}

  @doc "PREFLIGHT_CALIBRATION."
  @spec command(Vehicle.t(), Command.t()) :: Vehicle.t()
  def command(%{armed: true} = v, c), do: Vehicle.ack(v, c, @failed)

  def command(v, c) do
    v = Vehicle.ack(v, c, @accepted)

    cond do
      Command.p(c, 5) == 1.0 ->
        ask(v, 1)

      Command.p(c, 6) == 1.0 ->
        v = Vehicle.put_own(%{v | armed: true, armed_at: v.now}, :calibrating, {:compass_motor, c})
        Vehicle.text(v, 6, "Starting calibration")

      true ->
        v
    end
  end

  @doc "ACCELCAL_VEHICLE_POS."
  @spec position(Vehicle.t(), Command.t()) :: Vehicle.t()
  def position(v, c) do
    position = Command.p(c, 1)

    case running(v) do
      {:accelerometer, step} when step == position -> v |> Vehicle.ack(c, @accepted) |> sampled(step)
      _other -> Vehicle.ack(v, c, @failed)
    end
  end

  @doc "COMMAND_ACK."
  @spec acknowledged(Vehicle.t(), struct) :: Vehicle.t()
  def acknowledged(v, %M.CommandAck{command: command, result: result}) do
    case running(v) do
      {:compass_motor, c} ->
        v = Vehicle.put_own(%{v | armed: false}, :calibrating, nil)
        v |> Vehicle.text(5, "Failed") |> Vehicle.ack(c, @accepted)

      {:accelerometer, step} when command <= 6 and result == @temporarily_rejected ->
        sampled(v, step)

      _other ->
        v
    end
  end

  @doc "Whether the main loop waits for the calibration of compass and motors to end."
  @spec holds?(Vehicle.t()) :: boolean
  def holds?(v), do: match?({:compass_motor, _command}, running(v))

  @doc "The calibration that runs, and how far it is."
  @spec running(Vehicle.t()) :: {atom, term} | nil
  def running(v), do: Vehicle.own(v, :calibrating)

  defp sampled(v, 6), do: v |> Vehicle.put_own(:calibrating, nil) |> Vehicle.text(2, "Calibration successful")
  defp sampled(v, step), do: ask(v, step + 1)

  defp ask(v, step) do
    v = Vehicle.put_own(v, :calibrating, {:accelerometer, step})
    Vehicle.text(v, 2, "Place vehicle #{elem(@positions, step - 1)} and press any key.")
  end
end
