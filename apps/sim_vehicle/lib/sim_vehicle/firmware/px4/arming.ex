defmodule SimVehicle.Firmware.Px4.Arming do
  @moduledoc """
  PX4's arming and disarming, with its events.
  """

  import MavCodec.Command

  alias MavCodec.Enums.MavResult
  alias SimVehicle.{Flight, Params, Vehicle}
  alias SimVehicle.Services.Command
  alias SimVehicle.Firmware.Px4.{Events, Modes}

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @force 21_196

  # Reasons of commander_disarmed_by.
  @by_command 4
  @by_landing 6
  @by_preflight 7
  @calibration_us 1_050_000
  # How often a calibration looks whether it is cancelled.
  @look_us 2_000_000

  @doc "COMPONENT_ARM_DISARM with 1. Forcing does not help against failing checks in this version."
  @spec arm(Vehicle.t(), Command.t()) :: Vehicle.t()
  def arm(%{armed: true} = v, c), do: Vehicle.ack(v, c, @accepted)

  def arm(v, c) do
    if calibrating?(v), do: busy(v, c), else: check(v, c)
  end

  defp busy(v, c) do
    v
    |> Vehicle.ack(c, @temporarily_rejected)
    |> Events.emit(:arming_denied_calibrating, [], {2, "Arming denied: calibrating"})
  end

  defp check(v, c) do
    if healthy?(v) and Modes.available?(v, v.mode) do
      v
      |> Vehicle.ack(c, @accepted)
      |> Events.emit(:armed, [@by_command], {6, "Armed by external command"})
      |> Vehicle.put_own(:landed_at, nil)
      |> Vehicle.arm()
      |> Modes.enter(v.mode)
    else
      v
      |> Vehicle.ack(c, @temporarily_rejected)
      |> Events.emit(:arming_denied, [], {2, "Arming denied: Resolve system health failures first"})
    end
  end

  @doc "COMPONENT_ARM_DISARM with 0."
  @spec disarm(Vehicle.t(), Command.t(), number) :: Vehicle.t()
  def disarm(%{armed: false} = v, c, _force), do: Vehicle.ack(v, c, @accepted)

  def disarm(%{airborne: true} = v, c, force) when force != @force do
    v
    |> Vehicle.ack(c, @temporarily_rejected)
    |> Events.emit(:disarming_denied, [], {2, "Disarming denied: not landed"})
  end

  def disarm(v, c, _force), do: v |> Vehicle.ack(c, @accepted) |> stop(@by_command)

  @doc "Starts a calibration of the gyros or the accelerometer."
  @spec calibrate(Vehicle.t(), String.t()) :: Vehicle.t()
  def calibrate(v, sensor) do
    over = if sensor == "gyro", do: v.now + @calibration_us, else: :never

    v
    |> Vehicle.put_own(:calibrating, {sensor, over, v.now + @look_us})
    |> Vehicle.put_own(:last_command, nil)
    |> Vehicle.text(6, "[cal] calibration started: 2 #{sensor}")
  end

  @doc """
  A command came. The worker of a calibration sees only the last one when it looks, now and then, whether it is cancelled
  (`calibrate_cancel_check`, calibration_routines.cpp).
  """
  @spec heard(Vehicle.t(), Command.t()) :: Vehicle.t()
  def heard(v, c),
    do: if(calibrating?(v), do: Vehicle.put_own(v, :last_command, {c.id, c.params}), else: v)

  @doc "True while a calibration runs."
  @spec calibrating?(Vehicle.t()) :: boolean
  def calibrating?(v), do: Vehicle.own(v, :calibrating) != nil

  @doc "True when the checks pass that do not depend on the mode."
  @spec healthy?(Vehicle.t()) :: boolean
  def healthy?(v), do: Vehicle.positioned?(v) and not MapSet.member?(v.failsafes, :battery_critical)

  @doc "Stops the motors. Back on the ground the mode is hold again."
  @spec stop(Vehicle.t(), integer) :: Vehicle.t()
  def stop(v, reason) do
    words = %{@by_landing => "Disarmed by landing", @by_preflight => "Disarmed by auto preflight disarming"}
    text = Map.get(words, reason, "Disarmed by external command")
    v = v |> Events.emit(:disarmed, [reason], {6, text}) |> Flight.disarm()
    v = if v.airborne, do: v, else: %{v | landed: :on_ground}

    if v.mode in ["AUTO_LAND", "AUTO_RTL", "AUTO_TAKEOFF"] and not v.airborne,
      do: Modes.enter(v, "AUTO_LOITER"),
      else: v
  end

  @doc "Disarms by itself: two seconds after a landing, ten after arming without taking off."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(%{armed: true, airborne: false} = v) do
    landed_at = Vehicle.own(v, :landed_at)
    after_landing = Params.get(v.params, "COM_DISARM_LAND")
    after_arming = Params.get(v.params, "COM_DISARM_PRFLT")

    cond do
      landed_at != nil and after_landing > 0 and v.now - landed_at >= after_landing * 1.0e6 ->
        stop(v, @by_landing)

      landed_at == nil and after_arming > 0 and idle_for(v) >= after_arming * 1.0e6 ->
        stop(v, @by_preflight)

      true ->
        v
    end
  end

  def tick(v) do
    case Vehicle.own(v, :calibrating) do
      {sensor, over, _look_at} when is_integer(over) and v.now >= over ->
        v |> Vehicle.put_own(:calibrating, nil) |> Vehicle.text(6, "[cal] calibration done: #{sensor}")

      {sensor, over, look_at} when v.now >= look_at ->
        check_calibration(v, {sensor, over, v.now + @look_us}, Vehicle.own(v, :last_command))

      _none_or_running ->
        v
    end
  end

  defp check_calibration(v, calibration, {cmd(:PREFLIGHT_CALIBRATION), params}) do
    if Enum.all?(Tuple.to_list(params), &(&1 == 0)),
      do: v |> Vehicle.put_own(:calibrating, nil) |> Vehicle.text(2, "[cal] calibration cancelled"),
      else: check_calibration(v, calibration, nil)
  end

  defp check_calibration(v, calibration, _other),
    do: v |> Vehicle.put_own(:calibrating, calibration) |> Vehicle.put_own(:last_command, nil)

  defp idle_for(%{flight: :idle} = v), do: v.now - v.armed_at
  defp idle_for(_v), do: 0
end
