defmodule Aerie.Vehicle.State.Motion do
  @moduledoc "The groups position, attitude, velocity, gps and home, and the origin of local coordinates."
  @behaviour Aerie.Vehicle.State

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Value
  alias MavCodec.Enums.GpsFixType
  alias MavCodec.Messages, as: M

  @impl State
  def read(%M.GlobalPositionInt{} = m, _state, _at) do
    case Value.lat_lon(m.lat, m.lon) do
      :invalid ->
        {:invalid, :global_position_int}

      place ->
        {lat, lon} = place || {nil, nil}

        none? = m.alt == 0 and m.relative_alt == 0

        position = %{
          lat: lat,
          lon: lon,
          alt_msl: Value.height(place, m.alt, none?),
          alt_rel: Value.height(place, m.relative_alt, none?),
          heading: heading(m.hdg)
        }

        velocity = %{
          vn: Value.signed(m.vx, 16, 100),
          ve: Value.signed(m.vy, 16, 100),
          vd: Value.signed(m.vz, 16, 100)
        }

        {[], position: position, velocity: velocity}
    end
  end

  def read(%M.LocalPositionNed{} = m, _state, _at) do
    {[], velocity: %{vn: Value.float(m.vx), ve: Value.float(m.vy), vd: Value.float(m.vz)}}
  end

  def read(%M.VfrHud{} = m, _state, _at) do
    {[],
     velocity: %{
       groundspeed: Value.float(m.groundspeed),
       airspeed: Value.float(m.airspeed),
       climb: Value.float(m.climb),
       throttle: Value.up_to(m.throttle, 100, 100)
     }}
  end

  def read(%M.Attitude{} = m, _state, _at) do
    {[], attitude: attitude(Value.degrees(m.roll), Value.degrees(m.pitch), Value.degrees(m.yaw), m)}
  end

  def read(%M.AttitudeQuaternion{q1: w, q2: x, q3: y, q4: z} = m, _state, _at)
      when is_float(w) and is_float(x) and is_float(y) and is_float(z) do
    roll = :math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = :math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    yaw = :math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    {[], attitude: attitude(Value.degrees(roll), Value.degrees(pitch), Value.degrees(yaw), m)}
  end

  def read(%M.AttitudeQuaternion{}, _state, _at), do: {:invalid, :attitude_quaternion}

  def read(%M.GpsRawInt{} = m, _state, _at) do
    case Value.lat_lon(m.lat, m.lon) do
      :invalid ->
        {:invalid, :gps_raw_int}

      place ->
        {lat, lon} = place || {nil, nil}

        {[],
         gps: %{
           fix: m.fix_type,
           fix_name: GpsFixType.label(m.fix_type) || "FIX(#{m.fix_type})",
           satellites: Value.unsigned(m.satellites_visible, 8),
           hdop: dilution(m.eph),
           vdop: dilution(m.epv),
           lat: lat,
           lon: lon,
           alt_msl: Value.height(place, m.alt, m.alt == 0),
           h_acc: accuracy(m.h_acc),
           v_acc: accuracy(m.v_acc)
         }}
    end
  end

  # PX4 accepts a home position at 95 degrees north, and publishes it.
  def read(%M.HomePosition{} = m, _state, _at) do
    case Value.lat_lon(m.latitude, m.longitude) do
      {lat, lon} -> {[], home: %{lat: lat, lon: lon, alt_msl: Value.millimetres(m.altitude)}}
      nil -> {[], []}
      :invalid -> {:invalid, :home_position}
    end
  end

  # Where its local coordinates begin.
  def read(%M.GpsGlobalOrigin{} = m, _state, _at) do
    case Value.lat_lon(m.latitude, m.longitude) do
      {lat, lon} -> {[origin: %{lat: lat, lon: lon, alt_msl: Value.millimetres(m.altitude)}], []}
      nil -> {[], []}
      :invalid -> {:invalid, :gps_global_origin}
    end
  end

  defp attitude(roll, pitch, yaw, rates) do
    %{
      roll: roll,
      pitch: pitch,
      yaw: yaw,
      rollspeed: Value.degrees(rates.rollspeed),
      pitchspeed: Value.degrees(rates.pitchspeed),
      yawspeed: Value.degrees(rates.yawspeed)
    }
  end

  # Receivers without a fix, and both firmwares with them, say 99.99.
  defp dilution(9_999), do: nil
  defp dilution(value), do: Value.unsigned(value, 16, 100)

  # An extension: zero if the sender does not know it.
  defp accuracy(0), do: nil
  defp accuracy(value), do: Value.unsigned(value, 32, 1000)

  defp heading(hdg) when hdg in 0..36_000, do: rem(hdg, 36_000) / 100
  defp heading(_unknown), do: nil
end
