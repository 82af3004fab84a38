defmodule Msp.Telemetry do
  @moduledoc """
  MAVLink messages for what a flight controller said: what an autopilot would have sent. A message is sent when a reply brought what is
  in it, never from memory alone, so that its age is that of the reply. What is not known has MAVLink's value for that.
  """

  import Bitwise

  alias MavCodec.Enums.{MavSysStatusSensor, MavType}
  alias MavCodec.Messages, as: M
  alias Msp.{Arming, Identity, Mission, Modes, Readings}

  @nan :nan
  # MAV_MODE_FLAG
  @custom 1
  @armed 128
  # MAV_STATE
  @calibrating 2
  @standby 3
  @active 4
  @critical 5
  @prearm MavSysStatusSensor.value(:MAV_SYS_STATUS_PREARM_CHECK)
  @receiver MavSysStatusSensor.value(:MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
  # The sensors of both firmwares by their bits, as far as MAVLink has them.
  @sensors for {bit, name} <- [
                 {0, :"3D_ACCEL"},
                 {1, :ABSOLUTE_PRESSURE},
                 {2, :"3D_MAG"},
                 {3, :GPS},
                 {4, :LASER_POSITION}
               ],
               do: {bit, MavSysStatusSensor.value(:"MAV_SYS_STATUS_SENSOR_#{name}")}
  @more_sensors %{
    betaflight: [{5, :"3D_GYRO"}, {6, :OPTICAL_FLOW}],
    inav: [{5, :OPTICAL_FLOW}, {6, :DIFFERENTIAL_PRESSURE}]
  }
  # The mode of NAV_STATUS; MISSION_STATE
  @nav_mission 3
  @mission_not_started 2
  @mission_active 3
  @charge %{ok: 1, low: 2, critical: 3}
  # iNav's platform types, and Betaflight's mixers, which are all copters but for the wings.
  @types %{
    betaflight: %{
      TRICOPTER: [1],
      QUADROTOR: [2, 3],
      HEXAROTOR: [7, 10],
      OCTOROTOR: [11, 12, 13],
      FIXED_WING: [8, 14]
    },
    inav: %{FIXED_WING: [1], HELICOPTER: [2], TRICOPTER: [3], GROUND_ROVER: [4], SURFACE_BOAT: [5]}
  }
  @type_numbers (for {firmware, types} <- @types, {name, numbers} <- types, number <- numbers, into: %{} do
                   {{firmware, number}, MavType.value(:"MAV_TYPE_#{name}")}
                 end)
  @quadrotor MavType.value(:MAV_TYPE_QUADROTOR)
  @multirotor MavType.value(:MAV_TYPE_GENERIC_MULTIROTOR)

  @doc "The MAV_TYPE of a vehicle: by the mixer of Betaflight, by the platform type of iNav."
  @spec type(Modes.firmware(), non_neg_integer | nil) :: non_neg_integer
  def type(firmware, number) do
    case @type_numbers do
      %{{^firmware, ^number} => type} -> type
      _other -> if firmware == :inav, do: @multirotor, else: @quadrotor
    end
  end

  @doc "HEARTBEAT."
  @spec heartbeat(Identity.t(), non_neg_integer, Readings.t()) :: struct
  def heartbeat(identity, type, readings) do
    armed? = Modes.armed?(readings.boxes)

    %M.Heartbeat{
      type: type,
      autopilot: 0,
      base_mode: @custom + if(armed?, do: @armed, else: 0),
      custom_mode: Modes.mode(identity.firmware, readings.boxes),
      system_status: status(readings, armed?)
    }
  end

  defp status(readings, armed?) do
    cond do
      Modes.failsafe?(readings.boxes) -> @critical
      armed? -> @active
      calibrating?(readings[:arming]) -> @calibrating
      true -> @standby
    end
  end

  defp calibrating?(nil), do: false
  defp calibrating?(flags), do: (flags >>> 12 &&& 1) == 1

  @doc "SYS_STATUS: sensors, what keeps it from being armed, load, and the battery."
  @spec sys_status(Identity.t(), Readings.t()) :: struct
  def sys_status(identity, readings) do
    target = Identity.target(identity)
    armed? = Modes.armed?(readings.boxes)
    present = sensors(identity.firmware, readings[:sensors] || 0)
    failing = sensors(identity.firmware, readings[:unhealthy] || 0)
    {rc, rc_fails} = bit(Arming.rc_lost?(target, readings.arming || 0, armed?), @receiver)
    {ready, not_ready} = bit(readings.arming && Arming.names(target, readings.arming) != [], @prearm)
    all = present ||| failing ||| rc ||| ready

    %M.SysStatus{
      onboard_control_sensors_present: all,
      onboard_control_sensors_enabled: all,
      onboard_control_sensors_health: all &&& bnot(failing ||| rc_fails ||| not_ready),
      load: if(readings[:load], do: round(readings.load * 1000), else: 0xFFFF),
      voltage_battery: scaled(readings[:voltage], 1000, :u16),
      current_battery: scaled(readings[:current], 100, :current),
      battery_remaining: scaled(readings[:remaining], 100, :percent),
      drop_rate_comm: 0xFFFF
    }
  end

  # An unknown one is not there.
  defp bit(nil, _bit), do: {0, 0}
  defp bit(fails?, bit), do: {bit, if(fails?, do: bit, else: 0)}

  defp sensors(firmware, bits) do
    for {bit, value} <- @sensors ++ more(firmware),
        (bits >>> bit &&& 1) == 1,
        reduce: 0,
        do: (sum -> sum ||| value)
  end

  defp more(firmware) do
    for {bit, name} <- @more_sensors[firmware],
        do: {bit, MavSysStatusSensor.value(:"MAV_SYS_STATUS_SENSOR_#{name}")}
  end

  @doc "ATTITUDE; the rates are not known."
  @spec attitude(Readings.t(), boot_ms :: non_neg_integer) :: struct
  def attitude(readings, boot_ms) do
    %M.Attitude{
      time_boot_ms: boot_ms,
      roll: radians(readings.roll),
      pitch: radians(readings.pitch),
      yaw: radians(wrap(readings.yaw)),
      rollspeed: @nan,
      pitchspeed: @nan,
      yawspeed: @nan
    }
  end

  defp wrap(yaw) when yaw > 180, do: yaw - 360
  defp wrap(yaw), do: yaw
  defp radians(degrees), do: degrees * :math.pi() / 180

  @doc "GPS_RAW_INT."
  @spec gps_raw(Readings.t(), boot_us :: integer) :: struct
  def gps_raw(readings, boot_us) do
    %M.GpsRawInt{
      time_usec: boot_us,
      fix_type: readings.fix,
      lat: scaled(readings.lat, 1.0e7, :place),
      lon: scaled(readings.lon, 1.0e7, :place),
      alt: scaled(readings.alt_msl, 1000, :height),
      eph: scaled(readings.dilution, 1, :u16),
      epv: 0xFFFF,
      vel: scaled(readings.speed, 100, :u16),
      cog: scaled(readings.course, 100, :u16),
      satellites_visible: scaled(readings.satellites, 1, :u8)
    }
  end

  @doc """
  GLOBAL_POSITION_INT; none without a position of the receiver. It cannot leave out the height above home, which is 0 then: ALTITUDE says
  whether it is known (`height/2`).
  """
  @spec position(Readings.t(), boot_ms :: non_neg_integer) :: [struct]
  def position(%{lat: lat, lon: lon, alt_msl: msl} = readings, boot_ms)
      when is_number(lat) and is_number(msl) do
    {north, east} = velocity(readings[:speed], readings[:course])

    [
      %M.GlobalPositionInt{
        time_boot_ms: boot_ms,
        lat: scaled(lat, 1.0e7, :place),
        lon: scaled(lon, 1.0e7, :place),
        alt: scaled(msl, 1000, :height),
        relative_alt: scaled(readings[:alt_rel] || 0, 1000, :i32),
        vx: scaled(north, 100, :i16),
        vy: scaled(east, 100, :i16),
        vz: scaled(readings[:climb] && -readings.climb, 100, :i16),
        hdg: scaled(readings[:yaw], 100, :u16)
      }
    ]
  end

  def position(_readings, _boot_ms), do: []

  @doc "ALTITUDE: the height above home, and above the sea where the receiver has a position."
  @spec height(Readings.t(), boot_us :: integer) :: struct
  def height(readings, boot_us) do
    height = readings[:alt_rel] || @nan

    %M.Altitude{
      time_usec: boot_us,
      altitude_monotonic: @nan,
      altitude_amsl: (readings[:lat] && readings[:alt_msl]) || @nan,
      altitude_local: height,
      altitude_relative: height,
      altitude_terrain: @nan,
      bottom_clearance: @nan
    }
  end

  defp velocity(speed, course) when is_number(speed) and is_number(course),
    do: {speed * :math.cos(radians(course)), speed * :math.sin(radians(course))}

  defp velocity(_speed, _course), do: {nil, nil}

  @doc "BATTERY_STATUS; none while no battery is connected."
  @spec battery(Readings.t()) :: [struct]
  def battery(%{voltage: nil}), do: []

  def battery(readings) do
    [
      %M.BatteryStatus{
        voltages: [scaled(readings.voltage, 1000, :u16) | List.duplicate(0xFFFF, 9)],
        current_battery: scaled(readings.current, 100, :current),
        current_consumed: scaled(readings.drawn, 1, :consumed),
        energy_consumed: -1,
        battery_remaining: scaled(readings.remaining, 100, :percent),
        temperature: 0x7FFF,
        charge_state: Map.get(@charge, readings.charge, 0)
      }
    ]
  end

  @doc "RC_CHANNELS."
  @spec rc(Readings.t(), boot_ms :: non_neg_integer) :: struct
  def rc(readings, boot_ms) do
    channels = Enum.take(readings.channels, 18)
    known = for {us, n} <- Enum.with_index(channels, 1), do: {:"chan#{n}_raw", us}
    none = for n <- (length(channels) + 1)..18//1, do: {:"chan#{n}_raw", 0xFFFF}

    struct!(
      %M.RcChannels{
        time_boot_ms: boot_ms,
        chancount: length(channels),
        rssi: scaled(readings[:rssi], 254, :u8)
      },
      known ++ none
    )
  end

  @doc "MISSION_CURRENT of iNav, which counts its waypoints from 1; none without a mission. A mission that was read has items, too."
  @spec mission(Readings.t(), map | nil) :: [struct]
  def mission(%{waypoints: count, waypoint: number, nav_mode: mode}, known) when count > 0 do
    {seq, total} =
      if known,
        do: {Mission.seq(known.waypoints, number), length(known.items)},
        else: {max(number - 1, 0), count}

    [
      %M.MissionCurrent{
        seq: seq,
        total: total,
        mission_state: if(mode == @nav_mission, do: @mission_active, else: @mission_not_started)
      }
    ]
  end

  def mission(_readings, _known), do: []

  @doc "HOME_POSITION of iNav; none as long as it has none."
  @spec home(Readings.t()) :: [struct]
  def home(%{home: {lat, lon, msl}}) do
    [
      %M.HomePosition{
        latitude: scaled(lat, 1.0e7, :place),
        longitude: scaled(lon, 1.0e7, :place),
        altitude: scaled(msl, 1000, :i32),
        q: [1.0, 0.0, 0.0, 0.0]
      }
    ]
  end

  def home(_readings), do: []

  # What does not fit is not known: a flight controller may send anything.
  @ranges %{
    u8: {0..254, 0xFF},
    u16: {0..0xFFFE, 0xFFFF},
    i16: {-0x7FFF..0x7FFE, 0x7FFF},
    i32: {-0x7FFFFFFF..0x7FFFFFFE, 0x7FFFFFFF},
    # Per cent, and what is positive: -1 is unknown.
    percent: {0..100, -1},
    current: {-0x7FFF..0x7FFF, -1},
    consumed: {0..0x7FFFFFFF, -1},
    place: {-1_800_000_000..1_800_000_000, 0},
    height: {-0x7FFFFFFF..0x7FFFFFFE, 0}
  }

  defp scaled(nil, _factor, kind), do: elem(@ranges[kind], 1)

  defp scaled(value, factor, kind) do
    {range, unknown} = @ranges[kind]
    number = round(value * factor)
    if number in range, do: number, else: unknown
  end
end
