defmodule Aerie.Vehicle.State.Position do
  @moduledoc "The vehicle's position; GLOBAL_POSITION_INT has its velocity, too."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  use Group,
    name: :position,
    title: "The vehicle's position.",
    sampling: {:time, 1.0, %{}, 30.0},
    messages: [M.GlobalPositionInt, {M.Altitude, M.GlobalPositionInt}],
    fields: [
      {:lat, 7, "°", "latitude, WGS 84, north is positive", "GLOBAL_POSITION_INT, HIGH_LATENCY2", -90..90},
      {:lon, 7, "°", "longitude, east is positive", "GLOBAL_POSITION_INT, HIGH_LATENCY2", -180..180},
      {:alt_msl, 2, "m", "height above mean sea level", "GLOBAL_POSITION_INT, HIGH_LATENCY2"},
      {:alt_rel, 2, "m", "height above home, not above the ground", "GLOBAL_POSITION_INT, ALTITUDE"},
      {:heading, 2, "°", "direction of the nose, 0..360 from north", "GLOBAL_POSITION_INT, HIGH_LATENCY2",
       0..360}
    ]

  @impl Group
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

  # By MSP, while there is no position: one from before is none. PX4 sends it besides.
  def read(%M.Altitude{}, %{autopilot: autopilot}, _at) when autopilot not in [:betaflight, :inav],
    do: {[], []}

  def read(%M.Altitude{} = m, _state, _at) do
    {[],
     position: %{
       lat: nil,
       lon: nil,
       alt_msl: Value.float(m.altitude_amsl),
       alt_rel: Value.float(m.altitude_relative),
       heading: nil
     }}
  end

  defp heading(hdg) when hdg in 0..36_000, do: rem(hdg, 36_000) / 100
  defp heading(_unknown), do: nil
end
