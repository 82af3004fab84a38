defmodule MavCodec.Bench.FlightMessages do
  @moduledoc "Messages with values that look like a flight, for `MavCodec.Bench.TelemetryMix`."

  alias MavCodec.Messages, as: M

  defp near(value, spread), do: value + :rand.uniform(2 * spread) - spread
  defp float(value, spread), do: value + spread * (:rand.uniform() - 0.5)

  @doc "A message of a kind, `ms` after boot."
  def message(:heartbeat, _ms),
    do: %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: 217,
      custom_mode: 4,
      system_status: 4,
      mavlink_version: 3
    }

  def message(:attitude, ms) do
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

  def message(:global_position_int, ms) do
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

  def message(:vfr_hud, _ms) do
    %M.VfrHud{
      airspeed: float(5.0, 2.0),
      groundspeed: float(5.0, 2.0),
      heading: near(180, 90),
      throttle: near(40, 10),
      alt: float(604.0, 1.0),
      climb: float(0.0, 1.0)
    }
  end

  def message(:gps_raw_int, ms) do
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

  def message(:sys_status, _ms) do
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

  def message(:battery_status, _ms) do
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

  def message(:rc_channels, ms) do
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

  def message(:servo_output_raw, ms) do
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

  def message(:local_position_ned, ms) do
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

  def message(:raw_imu, ms) do
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

  def message(:nav_controller_output, _ms) do
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

  def message(:system_time, ms),
    do: %M.SystemTime{time_unix_usec: 1_795_213_318_360_000 + ms * 1000, time_boot_ms: ms}

  def message(:scaled_pressure, ms) do
    %M.ScaledPressure{
      time_boot_ms: ms,
      press_abs: float(945.0, 1.0),
      press_diff: float(0.0, 0.1),
      temperature: 3500
    }
  end

  def message(:vibration, ms) do
    %M.Vibration{
      time_usec: ms * 1000,
      vibration_x: float(0.01, 0.01),
      vibration_y: float(0.01, 0.01),
      vibration_z: float(0.01, 0.01)
    }
  end

  def message(:ekf_status_report, _ms) do
    %M.EkfStatusReport{
      flags: 831,
      velocity_variance: float(0.1, 0.1),
      pos_horiz_variance: float(0.1, 0.1),
      pos_vert_variance: float(0.1, 0.1),
      compass_variance: float(0.1, 0.1)
    }
  end

  def message(:highres_imu, ms) do
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

  def message(:ahrs2, _ms) do
    %M.Ahrs2{
      roll: float(0.2, 0.1),
      pitch: float(0.0, 0.1),
      yaw: float(1.0, 2.0),
      altitude: float(548.0, 5.0),
      lat: near(473_977_420, 9000),
      lng: near(85_455_940, 9000)
    }
  end

  def message(:esc_telemetry, ms) do
    %M.EscTelemetry1To4{
      temperature: for(_ <- 1..4, into: <<>>, do: <<near(45, 2)>>),
      voltage: List.duplicate(1550, 4),
      current: for(_ <- 1..4, do: near(550, 10)),
      totalcurrent: List.duplicate(div(ms, 100), 4) |> Enum.map(&rem(&1, 60_000)),
      rpm: for(_ <- 1..4, do: near(5200, 80)),
      count: List.duplicate(rem(ms, 65_536), 4)
    }
  end

  def message(:distance_sensor, ms) do
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

  def message(:param_value, ms) do
    %M.ParamValue{
      param_id: Enum.at(~w(ATC_RAT_RLL_P INS_GYR_FILTER WPNAV_SPEED BATT_LOW_VOLT RTL_ALT), rem(ms, 5)),
      param_value: float(1000.0, 2000.0),
      param_type: 9,
      param_count: 900,
      param_index: rem(ms, 900)
    }
  end

  def message(:wind, _ms),
    do: %M.Wind{direction: float(120.0, 20.0), speed: float(4.0, 2.0), speed_z: float(0.0, 0.4)}

  def message(:power_status, _ms), do: %M.PowerStatus{vcc: near(5000, 50), vservo: near(5100, 50), flags: 3}
  def message(:meminfo, _ms), do: %M.Meminfo{freemem: 65_535, freemem32: near(160_000, 500)}
  def message(:timesync, ms), do: %M.Timesync{tc1: 0, ts1: ms * 1_000_000 + 1}
  def message(:extended_sys_state, _ms), do: %M.ExtendedSysState{landed_state: 2}

  def message(:mission_current, _ms),
    do: %M.MissionCurrent{seq: 3, total: 12, mission_state: 3, mission_mode: 1}

  def message(:terrain_report, _ms) do
    %M.TerrainReport{
      lat: near(473_977_420, 9000),
      lon: near(85_455_940, 9000),
      spacing: 100,
      terrain_height: float(488.0, 2.0),
      current_height: float(60.0, 5.0),
      loaded: 504
    }
  end

  def message(:statustext, ms) do
    texts = ["EKF3 IMU0 is using GPS", "Mission: 4 WP", "Field Elevation Set: 488m", "Reached command #5"]
    %M.Statustext{severity: 6, text: Enum.at(texts, rem(ms, 4))}
  end

  def message(:home_position, ms) do
    %M.HomePosition{
      latitude: 473_977_420,
      longitude: 85_455_940,
      altitude: 488_000,
      q: [1.0, 0.0, 0.0, 0.0],
      time_usec: ms * 1000
    }
  end

  def message(:mission_item_int, _ms) do
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

  def message(:command_ack, _ms), do: %M.CommandAck{command: 512, target_system: 255, target_component: 190}

  def message(:autopilot_version, _ms) do
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
