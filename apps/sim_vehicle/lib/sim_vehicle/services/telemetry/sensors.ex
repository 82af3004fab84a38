defmodule SimVehicle.Services.Telemetry.Sensors do
  @moduledoc false

  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Services.Telemetry

  @gravity 9.80665

  @spec message(Vehicle.t(), non_neg_integer) :: struct | nil
  def message(v, id(RawImu)), do: struct!(M.RawImu, Map.merge(imu(v), %{time_usec: v.now, temperature: 2744}))
  def message(v, id(ScaledPressure)), do: pressure(v, M.ScaledPressure)
  def message(v, id(ScaledPressure2)), do: pressure(v, M.ScaledPressure2)
  def message(v, id(Attitude)), do: attitude(v)
  def message(v, id(AttitudeQuaternion)), do: quaternion(v)
  def message(v, id(ServoOutputRaw)), do: servos(v)
  def message(v, id(RcChannels)), do: rc_channels(v)
  def message(v, id(HighresImu)), do: highres_imu(v)

  def message(v, id(ScaledImu2)),
    do: struct!(M.ScaledImu2, Map.put(imu(v), :time_boot_ms, Telemetry.boot_ms(v)))

  def message(v, id(ScaledImu3)),
    do: struct!(M.ScaledImu3, Map.put(imu(v), :time_boot_ms, Telemetry.boot_ms(v)))

  def message(v, id(Vibration)) do
    level = if v.airborne, do: 0.01, else: 0.003
    %M.Vibration{time_usec: v.now, vibration_x: level, vibration_y: level, vibration_z: level}
  end

  defp attitude(v) do
    %M.Attitude{
      time_boot_ms: Telemetry.boot_ms(v),
      roll: v.kin.roll,
      pitch: v.kin.pitch,
      yaw: v.kin.yaw,
      rollspeed: v.kin.rollspeed,
      pitchspeed: v.kin.pitchspeed,
      yawspeed: v.kin.yawspeed
    }
  end

  defp quaternion(v) do
    {cr, sr} = {:math.cos(v.kin.roll / 2), :math.sin(v.kin.roll / 2)}
    {cp, sp} = {:math.cos(v.kin.pitch / 2), :math.sin(v.kin.pitch / 2)}
    {cy, sy} = {:math.cos(v.kin.yaw / 2), :math.sin(v.kin.yaw / 2)}

    %M.AttitudeQuaternion{
      time_boot_ms: Telemetry.boot_ms(v),
      q1: cr * cp * cy + sr * sp * sy,
      q2: sr * cp * cy - cr * sp * sy,
      q3: cr * sp * cy + sr * cp * sy,
      q4: cr * cp * sy - sr * sp * cy,
      rollspeed: v.kin.rollspeed,
      pitchspeed: v.kin.pitchspeed,
      yawspeed: v.kin.yawspeed
    }
  end

  # Acceleration in mg and rates in mrad/s of the body frame.
  defp imu(v) do
    %{
      xacc: mg(@gravity * :math.sin(v.kin.pitch)),
      yacc: mg(-@gravity * :math.sin(v.kin.roll)),
      zacc: mg(v.kin.ad - @gravity),
      xgyro: milli(v.kin.rollspeed),
      ygyro: milli(v.kin.pitchspeed),
      zgyro: milli(v.kin.yawspeed),
      xmag: round(240 * :math.cos(v.kin.yaw)),
      ymag: round(-240 * :math.sin(v.kin.yaw)),
      zmag: -528
    }
  end

  defp highres_imu(v) do
    %M.HighresImu{
      time_usec: v.now,
      xacc: @gravity * :math.sin(v.kin.pitch),
      yacc: -@gravity * :math.sin(v.kin.roll),
      zacc: v.kin.ad - @gravity,
      xgyro: v.kin.rollspeed,
      ygyro: v.kin.pitchspeed,
      zgyro: v.kin.yawspeed,
      abs_pressure: hectopascal(v),
      pressure_alt: Vehicle.altitude(v),
      temperature: 27.0,
      fields_updated: 0x1FFF
    }
  end

  defp pressure(v, module) do
    struct!(module, time_boot_ms: Telemetry.boot_ms(v), press_abs: hectopascal(v), temperature: 2962)
  end

  defp hectopascal(v), do: 1013.25 * :math.pow(1 - 2.25577e-5 * Vehicle.altitude(v), 5.25588)

  defp servos(v) do
    pwm =
      cond do
        not v.armed -> 1000
        v.airborne -> 1250 + round(v.kin.throttle * 1000)
        true -> 1100
      end

    %M.ServoOutputRaw{
      time_usec: rem(v.now, 4_294_967_296),
      servo1_raw: pwm,
      servo2_raw: pwm,
      servo3_raw: pwm,
      servo4_raw: pwm
    }
  end

  defp rc_channels(v) do
    lost? = MapSet.member?(v.failsafes, :rc)

    %M.RcChannels{
      time_boot_ms: Telemetry.boot_ms(v),
      chancount: if(lost?, do: 0, else: 8),
      chan1_raw: Vehicle.overridden(v, 1) || 1500,
      chan2_raw: Vehicle.overridden(v, 2) || 1500,
      chan3_raw: Vehicle.overridden(v, 3) || if(lost?, do: 900, else: 1000),
      chan4_raw: Vehicle.overridden(v, 4) || 1500,
      chan5_raw: Vehicle.overridden(v, 5) || 1800,
      chan6_raw: Vehicle.overridden(v, 6) || 1000,
      chan7_raw: Vehicle.overridden(v, 7) || 1000,
      chan8_raw: Vehicle.overridden(v, 8) || 1800,
      rssi: if(lost?, do: 0, else: 255)
    }
  end

  defp mg(accel), do: milli(accel / @gravity)
  defp milli(value), do: (value * 1000) |> round() |> max(-32_768) |> min(32_767)
end
