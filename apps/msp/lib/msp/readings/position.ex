defmodule Msp.Readings.Position do
  @moduledoc """
  RAW_GPS and ALTITUDE: GPS_RAW_INT, GLOBAL_POSITION_INT and ALTITUDE.

  GLOBAL_POSITION_INT is not made without a position of the receiver. It cannot leave out the height above home, which
  is 0 then: ALTITUDE says whether it is known.
  """
  @behaviour Msp.Readings

  import Msp.Readings.Value

  alias MavCodec.Messages, as: M
  alias Msp.{Firmware, Readings}

  @impl Readings
  def polls do
    [
      {"RAW_GPS", %{}, [betaflight: 500, inav: 500], [M.GpsRawInt, M.GlobalPositionInt]},
      {"ALTITUDE", %{}, [betaflight: 500, inav: 500], [M.GlobalPositionInt]}
    ]
  end

  @impl Readings
  def read(_firmware, "ALTITUDE", %{altitude: altitude} = v, _ids),
    do: %{alt_rel: altitude / 100, climb: v[:vario] && v.vario / 100}

  def read(firmware, "RAW_GPS", %{fix: fix, lat: lat, lon: lon} = v, _ids) do
    fixes = Firmware.of(firmware).fixes
    fix = Map.get(fixes, fix, fixes.other)
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

  def read(_firmware, _name, _values, _ids), do: %{}

  @impl Readings
  def messages("RAW_GPS", readings, context), do: [gps_raw(readings, context) | position(readings, context)]
  def messages("ALTITUDE", readings, context), do: [height(readings, context)]

  defp gps_raw(readings, context) do
    %M.GpsRawInt{
      time_usec: context.boot_us,
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

  defp position(%{lat: lat, lon: lon, alt_msl: msl} = readings, context)
       when is_number(lat) and is_number(msl) do
    {north, east} = velocity(readings[:speed], readings[:course])

    [
      %M.GlobalPositionInt{
        time_boot_ms: context.boot_ms,
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

  defp position(_readings, _context), do: []

  defp height(readings, context) do
    height = readings[:alt_rel] || :nan

    %M.Altitude{
      time_usec: context.boot_us,
      altitude_monotonic: :nan,
      altitude_amsl: (readings[:lat] && readings[:alt_msl]) || :nan,
      altitude_local: height,
      altitude_relative: height,
      altitude_terrain: :nan,
      bottom_clearance: :nan
    }
  end

  defp velocity(speed, course) when is_number(speed) and is_number(course),
    do: {speed * :math.cos(radians(course)), speed * :math.sin(radians(course))}

  defp velocity(_speed, _course), do: {nil, nil}
end
