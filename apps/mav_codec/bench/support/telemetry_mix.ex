defmodule MavCodec.Bench.TelemetryMix do
  @moduledoc """
  The telemetry of a flying copter as the benchmarks use it: the messages of the usual streams at their usual rates
  relative to each other, with values that look like a flight. The same messages each time.
  """

  alias MavCodec.Messages, as: M

  # Message and its share. Together about 43 bytes a frame, as in recorded flights.
  @shares [
    attitude: 10,
    global_position_int: 4,
    vfr_hud: 4,
    gps_raw_int: 4,
    sys_status: 4,
    battery_status: 3,
    heartbeat: 1,
    rc_channels: 4,
    servo_output_raw: 4,
    local_position_ned: 4,
    raw_imu: 4,
    nav_controller_output: 2,
    system_time: 1,
    scaled_pressure: 1,
    vibration: 2,
    ekf_status_report: 2
  ]

  @doc "`count` messages."
  def messages(count) do
    :rand.seed(:exsss, {2026, 11, 20})
    kinds = for {kind, share} <- @shares, _ <- 1..share, do: kind
    kinds = List.to_tuple(Enum.shuffle(kinds))
    for i <- 0..(count - 1), do: message(elem(kinds, rem(i, tuple_size(kinds))), i * 5)
  end

  @doc "The frames of `messages`, in order, of system 1."
  def frames(messages) do
    {frames, _} = Enum.map_reduce(messages, MavCodec.Encoder.new(system: 1), &MavCodec.Encoder.encode(&2, &1))
    frames
  end

  @doc "Frames put together to reads of about `bytes` bytes, as TCP or a serial port gives them."
  def reads(frames, bytes) do
    frames
    |> Enum.chunk_while(
      {[], 0},
      fn frame, {held, size} ->
        if size + byte_size(frame) > bytes,
          do: {:cont, join(held), {[frame], byte_size(frame)}},
          else: {:cont, {[frame | held], size + byte_size(frame)}}
      end,
      fn {held, _} -> {:cont, join(held), {[], 0}} end
    )
  end

  defp join(held), do: held |> Enum.reverse() |> IO.iodata_to_binary()

  @doc "`data` with one byte in `n` replaced by another."
  def damage(frames, n) do
    :rand.seed(:exsss, {1, 2, 3})
    Enum.map(frames, &for(<<byte <- &1>>, into: <<>>, do: <<maybe(byte, n)>>))
  end

  defp maybe(byte, n), do: if(:rand.uniform(n) == 1, do: Bitwise.bxor(byte, :rand.uniform(255)), else: byte)

  defp near(value, spread), do: value + :rand.uniform(2 * spread) - spread
  defp float(value, spread), do: value + spread * (:rand.uniform() - 0.5)

  defp message(:heartbeat, _ms),
    do: %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: 217,
      custom_mode: 4,
      system_status: 4,
      mavlink_version: 3
    }

  defp message(:attitude, ms) do
    %M.Attitude{
      time_boot_ms: ms,
      roll: float(0.0, 0.2),
      pitch: float(0.05, 0.2),
      yaw: float(1.0, 2.0),
      rollspeed: float(0.0, 0.01),
      pitchspeed: float(0.0, 0.01),
      yawspeed: float(0.0, 0.01)
    }
  end

  defp message(:global_position_int, ms) do
    %M.GlobalPositionInt{
      time_boot_ms: ms,
      lat: near(-353_632_610, 9000),
      lon: near(1_491_652_300, 9000),
      alt: near(604_000, 500),
      relative_alt: near(20_000, 500),
      vx: near(0, 300),
      vy: near(0, 300),
      vz: near(0, 50),
      hdg: near(18_000, 9000)
    }
  end

  defp message(:vfr_hud, _ms) do
    %M.VfrHud{
      airspeed: float(5.0, 2.0),
      groundspeed: float(5.0, 2.0),
      heading: near(180, 90),
      throttle: near(40, 10),
      alt: float(604.0, 1.0),
      climb: float(0.0, 1.0)
    }
  end

  defp message(:gps_raw_int, ms) do
    %M.GpsRawInt{
      time_usec: ms * 1000,
      fix_type: 6,
      lat: near(-353_632_610, 9000),
      lon: near(1_491_652_300, 9000),
      alt: near(604_000, 500),
      eph: 121,
      epv: 200,
      vel: near(300, 100),
      cog: near(18_000, 9000),
      satellites_visible: 10,
      alt_ellipsoid: near(604_000, 500),
      h_acc: 200,
      v_acc: 300,
      vel_acc: 40,
      hdg_acc: 10
    }
  end

  defp message(:sys_status, _ms) do
    %M.SysStatus{
      onboard_control_sensors_present: 0x5721_FC2F,
      onboard_control_sensors_enabled: 0x4721_FC2F,
      onboard_control_sensors_health: 0x5721_FC2F,
      load: near(300, 50),
      voltage_battery: near(12_400, 50),
      current_battery: near(2500, 100),
      battery_remaining: 87
    }
  end

  defp message(:battery_status, _ms) do
    %M.BatteryStatus{
      battery_function: 0,
      type: 0,
      temperature: 32_767,
      voltages: [near(12_400, 50) | List.duplicate(65_535, 9)],
      current_battery: near(2500, 100),
      current_consumed: 400,
      energy_consumed: 180,
      time_remaining: near(900, 50),
      charge_state: 1,
      battery_remaining: 87
    }
  end

  defp message(:rc_channels, ms) do
    %M.RcChannels{
      time_boot_ms: ms,
      chancount: 16,
      chan1_raw: near(1500, 100),
      chan2_raw: near(1500, 100),
      chan3_raw: near(1400, 100),
      chan4_raw: near(1500, 100),
      chan5_raw: 1800,
      chan6_raw: 1000,
      chan7_raw: 1000,
      chan8_raw: 1800,
      chan9_raw: 1000,
      chan16_raw: 1000,
      rssi: 255
    }
  end

  defp message(:servo_output_raw, ms) do
    %M.ServoOutputRaw{
      time_usec: ms * 1000,
      servo1_raw: near(1500, 100),
      servo2_raw: near(1500, 100),
      servo3_raw: near(1500, 100),
      servo4_raw: near(1500, 100),
      servo9_raw: near(1500, 100),
      servo10_raw: near(1500, 100)
    }
  end

  defp message(:local_position_ned, ms) do
    %M.LocalPositionNed{
      time_boot_ms: ms,
      x: float(10.0, 5.0),
      y: float(-20.0, 5.0),
      z: float(-20.0, 1.0),
      vx: float(1.0, 1.0),
      vy: float(1.0, 1.0),
      vz: float(0.0, 0.2)
    }
  end

  defp message(:raw_imu, ms) do
    %M.RawImu{
      time_usec: ms * 1000,
      xacc: near(0, 50),
      yacc: near(0, 50),
      zacc: near(-1000, 50),
      xgyro: near(0, 20),
      ygyro: near(0, 20),
      zgyro: near(0, 20),
      xmag: near(230, 20),
      ymag: near(70, 20),
      zmag: near(-528, 20),
      temperature: 4500
    }
  end

  defp message(:nav_controller_output, _ms) do
    %M.NavControllerOutput{
      nav_roll: float(0.0, 10.0),
      nav_pitch: float(0.0, 10.0),
      alt_error: float(0.0, 0.5),
      aspd_error: float(0.0, 0.5),
      xtrack_error: float(0.0, 2.0),
      nav_bearing: near(10, 5),
      target_bearing: near(90, 5),
      wp_dist: 77
    }
  end

  defp message(:system_time, ms),
    do: %M.SystemTime{time_unix_usec: 1_795_213_318_360_000 + ms * 1000, time_boot_ms: ms}

  defp message(:scaled_pressure, ms) do
    %M.ScaledPressure{
      time_boot_ms: ms,
      press_abs: float(945.0, 1.0),
      press_diff: float(0.0, 0.1),
      temperature: 3500
    }
  end

  defp message(:vibration, ms) do
    %M.Vibration{
      time_usec: ms * 1000,
      vibration_x: float(0.01, 0.01),
      vibration_y: float(0.01, 0.01),
      vibration_z: float(0.01, 0.01)
    }
  end

  defp message(:ekf_status_report, _ms) do
    %M.EkfStatusReport{
      flags: 831,
      velocity_variance: float(0.1, 0.1),
      pos_horiz_variance: float(0.1, 0.1),
      pos_vert_variance: float(0.1, 0.1),
      compass_variance: float(0.1, 0.1)
    }
  end
end
