defmodule MavCodec.Bench.TelemetryMix do
  @moduledoc """
  The telemetry of three flying vehicles as the benchmarks use it: 33 messages of common and ardupilotmega at their usual rates,
  43 bytes a frame on average, with values that look like a flight. The same messages each time.
  """

  alias MavCodec.Messages, as: M
  alias MavCodec.Signing

  # Messages per second and vehicle.
  @rates [
    attitude: 25,
    highres_imu: 20,
    global_position_int: 10,
    local_position_ned: 10,
    vfr_hud: 10,
    raw_imu: 10,
    gps_raw_int: 5,
    rc_channels: 5,
    servo_output_raw: 5,
    scaled_pressure: 5,
    ahrs2: 5,
    nav_controller_output: 5,
    esc_telemetry: 5,
    distance_sensor: 5,
    param_value: 4,
    sys_status: 2,
    battery_status: 2,
    vibration: 2,
    ekf_status_report: 2,
    wind: 2,
    heartbeat: 1,
    power_status: 1,
    meminfo: 1,
    system_time: 1,
    timesync: 1,
    terrain_report: 1,
    extended_sys_state: 1,
    mission_current: 1,
    statustext: 0.5,
    home_position: 0.2,
    mission_item_int: 0.2,
    command_ack: 0.2,
    autopilot_version: 0.1
  ]

  @doc "`count` messages with the system that sends each: `{1..3, message}`."
  def messages(count) do
    :rand.seed(:exsss, {2026, 11, 20})
    kinds = for {kind, rate} <- @rates, _ <- 1..round(rate * 10), do: kind
    kinds = List.to_tuple(Enum.shuffle(kinds))

    for i <- 0..(count - 1),
        do: {:rand.uniform(3), message(elem(kinds, rem(i, tuple_size(kinds))), div(i, 3) * 7)}
  end

  @doc "The frames of `messages`, in order; in version 1 without those that it does not have."
  def frames(messages, version \\ 2) do
    messages =
      if version == 1, do: Enum.reject(messages, fn {_, %module{}} -> module.id() > 255 end), else: messages

    {frames, _} =
      Enum.map_reduce(messages, %{}, fn {system, message}, seqs ->
        seq = Map.get(seqs, system, 0)
        frame = MavCodec.encode(message, system: system, component: 1, seq: rem(seq, 256), version: version)
        {frame, Map.put(seqs, system, seq + 1)}
      end)

    frames
  end

  @doc "The frames of `messages`, signed with `key`."
  def signed(messages, key) do
    {frames, _} =
      Enum.map_reduce(messages, {%{}, Signing.new(key, link_id: 7)}, fn {system, message}, {seqs, signing} ->
        seq = Map.get(seqs, system, 0)
        {frame, signing} = Signing.encode(signing, message, system: system, component: 1, seq: rem(seq, 256))
        {frame, {Map.put(seqs, system, seq + 1), signing}}
      end)

    frames
  end

  @doc "Bytes in reads of `size`, as TCP or a serial port gives them."
  def cut(data, size) when byte_size(data) <= size, do: [data]

  def cut(data, size) do
    <<read::binary-size(^size), rest::binary>> = data
    [read | cut(rest, size)]
  end

  @doc """
  The frames with 1 % of their bytes damaged, as a line does it: half overwritten in bursts of 1 to 16 bytes, half garbage put
  in between, 1 to 40 bytes each; and the frames that stayed whole.
  """
  def damage(frames) do
    :rand.seed(:exsss, {1, 2, 3})

    {parts, whole} =
      Enum.map_reduce(frames, [], fn frame, whole ->
        # A burst of 8.5 bytes and garbage of 20.5 bytes on average, half a per cent each.
        burst? = :rand.uniform() < byte_size(frame) / 200 / 8.5
        garbage? = :rand.uniform() < byte_size(frame) / 200 / 20.5
        damaged = if burst?, do: overwrite(frame), else: frame
        damaged = if garbage?, do: insert(damaged), else: damaged
        {damaged, if(damaged == frame, do: [frame | whole], else: whole)}
      end)

    {IO.iodata_to_binary(parts), Enum.reverse(whole)}
  end

  defp overwrite(frame) do
    at = :rand.uniform(byte_size(frame)) - 1
    size = min(:rand.uniform(16), byte_size(frame) - at)
    <<before::binary-size(^at), burst::binary-size(^size), rest::binary>> = frame
    burst = for <<byte <- burst>>, into: <<>>, do: <<Bitwise.bxor(byte, :rand.uniform(255))>>
    <<before::binary, burst::binary, rest::binary>>
  end

  defp insert(frame) do
    at = :rand.uniform(byte_size(frame)) - 1
    <<before::binary-size(^at), rest::binary>> = frame
    <<before::binary, :rand.bytes(:rand.uniform(40))::binary, rest::binary>>
  end

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

  defp message(:highres_imu, ms) do
    %M.HighresImu{
      time_usec: ms * 1000,
      xacc: float(0.0, 0.6),
      yacc: float(0.0, 0.6),
      zacc: float(-9.81, 0.6),
      xgyro: float(0.0, 0.04),
      ygyro: float(0.0, 0.04),
      zgyro: float(0.1, 0.04),
      xmag: float(0.21, 0.01),
      ymag: float(0.03, 0.01),
      zmag: float(0.42, 0.01),
      abs_pressure: float(955.2, 0.2),
      diff_pressure: float(0.3, 0.1),
      pressure_alt: float(548.0, 5.0),
      temperature: float(41.2, 0.2),
      fields_updated: 8191,
      id: 1
    }
  end

  defp message(:ahrs2, _ms) do
    %M.Ahrs2{
      roll: float(0.2, 0.1),
      pitch: float(0.0, 0.1),
      yaw: float(1.0, 2.0),
      altitude: float(548.0, 5.0),
      lat: near(473_977_420, 9000),
      lng: near(85_455_940, 9000)
    }
  end

  defp message(:esc_telemetry, ms) do
    %M.EscTelemetry1To4{
      temperature: for(_ <- 1..4, into: <<>>, do: <<near(45, 2)>>),
      voltage: List.duplicate(1550, 4),
      current: for(_ <- 1..4, do: near(550, 10)),
      totalcurrent: List.duplicate(div(ms, 100), 4) |> Enum.map(&rem(&1, 60_000)),
      rpm: for(_ <- 1..4, do: near(5200, 80)),
      count: List.duplicate(rem(ms, 65_536), 4)
    }
  end

  defp message(:distance_sensor, ms) do
    %M.DistanceSensor{
      time_boot_ms: ms,
      min_distance: 20,
      max_distance: 5000,
      current_distance: near(3000, 300),
      id: 1,
      orientation: 25,
      horizontal_fov: 0.05,
      vertical_fov: 0.05,
      signal_quality: 93
    }
  end

  defp message(:param_value, ms) do
    %M.ParamValue{
      param_id: Enum.at(~w(ATC_RAT_RLL_P INS_GYR_FILTER WPNAV_SPEED BATT_LOW_VOLT RTL_ALT), rem(ms, 5)),
      param_value: float(1000.0, 2000.0),
      param_type: 9,
      param_count: 900,
      param_index: rem(ms, 900)
    }
  end

  defp message(:wind, _ms),
    do: %M.Wind{direction: float(120.0, 20.0), speed: float(4.0, 2.0), speed_z: float(0.0, 0.4)}

  defp message(:power_status, _ms), do: %M.PowerStatus{vcc: near(5000, 50), vservo: near(5100, 50), flags: 3}
  defp message(:meminfo, _ms), do: %M.Meminfo{freemem: 65_535, freemem32: near(160_000, 500)}
  defp message(:timesync, ms), do: %M.Timesync{tc1: 0, ts1: ms * 1_000_000 + 1}
  defp message(:extended_sys_state, _ms), do: %M.ExtendedSysState{landed_state: 2}

  defp message(:mission_current, _ms),
    do: %M.MissionCurrent{seq: 3, total: 12, mission_state: 3, mission_mode: 1}

  defp message(:terrain_report, _ms) do
    %M.TerrainReport{
      lat: near(473_977_420, 9000),
      lon: near(85_455_940, 9000),
      spacing: 100,
      terrain_height: float(488.0, 2.0),
      current_height: float(60.0, 5.0),
      loaded: 504
    }
  end

  defp message(:statustext, ms) do
    texts = ["EKF3 IMU0 is using GPS", "Mission: 4 WP", "Field Elevation Set: 488m", "Reached command #5"]
    %M.Statustext{severity: 6, text: Enum.at(texts, rem(ms, 4))}
  end

  defp message(:home_position, ms) do
    %M.HomePosition{
      latitude: 473_977_420,
      longitude: 85_455_940,
      altitude: 488_000,
      q: [1.0, 0.0, 0.0, 0.0],
      time_usec: ms * 1000
    }
  end

  defp message(:mission_item_int, _ms) do
    %M.MissionItemInt{
      target_system: 255,
      target_component: 190,
      seq: 3,
      frame: 6,
      command: 16,
      autocontinue: 1,
      param2: 2.0,
      x: near(473_977_420, 9000),
      y: near(85_455_940, 9000),
      z: 50.0
    }
  end

  defp message(:command_ack, _ms), do: %M.CommandAck{command: 512, target_system: 255, target_component: 190}

  defp message(:autopilot_version, _ms) do
    %M.AutopilotVersion{
      capabilities: 0xF1EF,
      flight_sw_version: 0x0405_03FF,
      board_version: 0x328,
      flight_custom_version: "a4f7c0de",
      os_custom_version: "38022f4f",
      vendor_id: 4617,
      product_id: 22_336,
      uid: 0x1122_3344_5566_7788,
      uid2: for(byte <- 1..18, into: <<>>, do: <<byte>>)
    }
  end
end
