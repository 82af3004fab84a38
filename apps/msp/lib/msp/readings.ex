defmodule Msp.Readings do
  @moduledoc """
  What the replies of a flight controller say, in one form for both firmwares: SI units, pitch positive with the nose up, and no
  value where the firmware sends a stand-in for an unknown one.
  """

  alias Msp.Modes

  @typedoc """
  - `boxes`: permanent ids of the boxes that are on, nil while BOXIDS is not known; `boxes_at`: when it said so;
    `arming`: the arming flags; `sensors`: the sensors' bits
  - `load`: 0..1
  - `roll`, `pitch`, `yaw`: degrees; `climb`: m/s
  - `alt_rel`: m above home, nil if that is not known, `alt_at`: when it was read; `alt_last`: the last one, and when;
    `alt_local`: m above iNav's origin
  - `fix`: GPS_FIX_TYPE; `satellites`; `lat`, `lon`: degrees; `alt_msl`: m; `speed`: m/s; `course`: degrees; `dilution`
  - `voltage`: V; `current`: A; `drawn`: mAh; `cells`; `remaining`: 0..1; `charge`: `:ok | :low | :critical | :absent`
  - `rssi`: 0..1; `channels`: µs in the order of the receiver (AETR)
  - `nav_mode`, `waypoint`: what iNav's navigation does (NAV_STATUS); `waypoints`: of its mission
  - `home`: `{lat, lon, alt_msl}` of iNav, nil without one; `here_msl`: how high it is itself; `origin_msl`: above what
    its ALTITUDE is; `on_s`: its seconds since its start
  - `unhealthy`: bits of `sensors` that do not work
  """
  @type t :: %{optional(atom) => term}

  @betaflight_charge %{0 => :ok, 1 => :low, 2 => :critical, 3 => :absent}
  @inav_charge %{0 => :ok, 1 => :low, 2 => :critical, 3 => :absent}
  # Its bit in the sensors of both firmwares; GPS_FIX_TYPE.
  @baro 1
  @fix_3d 3
  # Its place in BOXIDS says which flag means armed.
  @arm 0
  # SENSOR_STATUS, in the order of the bits of STATUS.
  @inav_sensors [acc: 0, baro: 1, mag: 2, gps: 3, rangefinder: 4, opflow: 5, pitot: 6]

  @doc "What a reply says; `ids` is the vehicle's BOXIDS. Nothing for one that says nothing about the state, or is cut short."
  @spec read(Modes.firmware(), name :: String.t(), MavCodec.Msp.Payload.values(), ids :: [byte]) :: t
  def read(firmware, name, values, ids)

  def read(:betaflight, name, %{mode_flags: low} = v, ids) when name in ["STATUS", "STATUS_EX"] do
    flags =
      for {%{flags: byte}, n} <- Enum.with_index(v[:more_flags] || []),
          reduce: low,
          do: (sum -> sum + Bitwise.bsl(byte, 32 + 8 * n))

    %{
      boxes: if(@arm in ids, do: Modes.boxes(flags, ids)),
      arming: v[:arming_disable_flags],
      sensors: v[:sensors],
      load: percent(v[:cpu_load])
    }
  end

  def read(:inav, "MSP2_INAV_STATUS", %{mode_flags: flags} = v, ids) do
    %{
      boxes: if(@arm in ids, do: Modes.boxes(flags, ids)),
      arming: v[:arming_flags],
      sensors: v[:sensors],
      load: percent(v[:cpu_load])
    }
  end

  def read(_firmware, "ATTITUDE", %{roll: roll, pitch: pitch, yaw: yaw}, _ids),
    do: %{roll: roll / 10, pitch: -pitch / 10, yaw: yaw * 1.0}

  def read(_firmware, "ALTITUDE", %{altitude: altitude} = v, _ids),
    do: %{alt_rel: altitude / 100, climb: v[:vario] && v.vario / 100}

  def read(firmware, "RAW_GPS", %{fix: fix, lat: lat, lon: lon} = v, _ids) do
    fix = gps_fix(firmware, fix)
    found? = fix >= 2

    %{
      fix: fix,
      satellites: v[:satellites],
      # Without a fix they are those of the last one.
      lat: if(found?, do: lat / 1.0e7),
      lon: if(found?, do: lon / 1.0e7),
      alt_msl: if(found?, do: v[:altitude] && v.altitude * 1.0),
      speed: if(found?, do: v[:ground_speed] && v.ground_speed / 100),
      course: if(found?, do: v[:course] && v.course / 10),
      dilution: v[:dop] || v[:hdop]
    }
  end

  def read(:betaflight, "ANALOG", v, _ids),
    do: %{rssi: rssi(v[:rssi])}

  def read(:betaflight, "BATTERY_STATE", %{cells: cells} = v, _ids) do
    there? = cells > 0
    capacity = v[:capacity] || 0

    %{
      cells: if(there?, do: cells),
      voltage: if(there?, do: volts(v)),
      current: if(there?, do: v[:current] && v.current / 100),
      drawn: if(there?, do: v[:drawn]),
      remaining: if(there? and capacity > 0 and is_integer(v[:drawn]), do: max(0.0, 1 - v.drawn / capacity)),
      charge: @betaflight_charge[v[:state]]
    }
  end

  def read(:inav, "MSP2_INAV_ANALOG", %{battery_flags: flags} = v, _ids) do
    charge = @inav_charge[flags |> Bitwise.bsr(2) |> Bitwise.band(3)]
    there? = charge != :absent

    %{
      cells: if(there?, do: Bitwise.bsr(flags, 4)),
      voltage: if(there?, do: v[:voltage] && v.voltage / 100),
      current: if(there?, do: v[:current] && v.current / 100),
      drawn: if(there?, do: v[:drawn]),
      remaining: if(there?, do: percent(v[:percentage])),
      charge: charge,
      rssi: rssi(v[:rssi])
    }
  end

  # Roll, pitch, yaw, throttle here; MAVLink and transmitters have the throttle before the yaw.
  def read(_firmware, "RC", %{entries: entries}, _ids) do
    case Enum.map(entries, & &1.channel) do
      [roll, pitch, yaw, throttle | more] -> %{channels: [roll, pitch, throttle, yaw | more]}
      few -> %{channels: few}
    end
  end

  def read(:inav, "NAV_STATUS", %{mode: mode, wp_number: number}, _ids),
    do: %{nav_mode: mode, waypoint: number}

  def read(:inav, "WP_GETINFO", %{count: count}, _ids), do: %{waypoints: count}

  def read(:inav, "MSP2_INAV_MISC2", v, _ids), do: %{on_s: v[:on_time]}

  def read(:inav, "SENSOR_STATUS", v, _ids) do
    # 1 is healthy, 2 unavailable although wanted, 3 unhealthy.
    bits =
      for {key, bit} <- @inav_sensors, v[key] in [2, 3], reduce: 0, do: (sum -> sum + Bitwise.bsl(1, bit))

    %{unhealthy: bits}
  end

  def read(:inav, "WP", %{number: 0, lat: lat, lon: lon, altitude: cm}, _ids) do
    if lat == 0 and lon == 0, do: %{home: nil}, else: %{home: {lat / 1.0e7, lon / 1.0e7, cm / 100}}
  end

  def read(:inav, "WP", %{number: 255, lat: lat, lon: lon, altitude: cm}, _ids),
    do: %{here_msl: if(lat != 0 or lon != 0, do: cm / 100)}

  def read(_firmware, _name, _values, _ids), do: %{}

  @doc "Whether it has a barometer that works, by which it knows how high it is."
  @spec barometer?(t) :: boolean
  def barometer?(readings), do: bit?(readings[:sensors], @baro) and not bit?(readings[:unhealthy], @baro)

  @doc "Whether it measures heights: without a barometer by its position. If not it says 0, however high it is."
  @spec altimeter?(t) :: boolean
  def altimeter?(readings), do: barometer?(readings) or (readings[:fix] || 0) >= @fix_3d

  defp bit?(bits, bit), do: Bitwise.band(Bitwise.bsr(bits || 0, bit), 1) == 1

  # A mask with Betaflight, of which a fix is a bit; it does not say whether there is a height.
  defp gps_fix(:betaflight, 0), do: 1
  defp gps_fix(:betaflight, _mask), do: 3
  defp gps_fix(:inav, fix) when fix in 0..2, do: fix + 1
  defp gps_fix(:inav, _other), do: 1

  # The byte saturates at 25.5 V; the word came with API 1.41.
  defp volts(%{voltage: centivolts}), do: centivolts / 100
  defp volts(%{voltage_dv: decivolts}) when decivolts < 255, do: decivolts / 10
  defp volts(_saturated), do: nil

  defp percent(nil), do: nil
  defp percent(value), do: min(value, 100) / 100

  # 0 where there is no source for it.
  defp rssi(value) when value in 1..1023, do: value / 1023
  defp rssi(_none), do: nil
end
