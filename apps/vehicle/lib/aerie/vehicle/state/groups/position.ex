defmodule Aerie.Vehicle.State.Groups.Position do
  @moduledoc "The vehicle's position; GLOBAL_POSITION_INT also has its velocity."

  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  use Group,
    name: :position,
    title: "The vehicle's position.",
    sampling: {:time, 1.0, %{}, 30.0},
    messages: [M.GlobalPositionInt, M.Altitude],
    fields: [
      {:lat, 7, "°", "latitude, WGS 84, north is positive", "GLOBAL_POSITION_INT, HIGH_LATENCY2", -90..90},
      {:lon, 7, "°", "longitude, east is positive", "GLOBAL_POSITION_INT, HIGH_LATENCY2", -180..180},
      {:alt_msl, 2, "m", "height above mean sea level", "GLOBAL_POSITION_INT, HIGH_LATENCY2"},
      {:alt_rel, 2, "m", "height above home, not above the ground", "GLOBAL_POSITION_INT, ALTITUDE"},
      {:heading, 2, "°", "direction of the nose, 0..360 from north", "GLOBAL_POSITION_INT, HIGH_LATENCY2",
       0..360}
    ]

  @impl Group
  def read(%M.GlobalPositionInt{} = m, state, _at) do
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
          alt_rel:
            if(height_apart?(state),
              do: known_height(state),
              else: Value.height(place, m.relative_alt, none?)
            ),
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

  # Others send it besides. Without a height above the sea an earlier position no longer counts.
  def read(%M.Altitude{} = m, state, _at) do
    height = %{alt_rel: Value.float(m.altitude_relative)}

    cond do
      not height_apart?(state) -> {[], []}
      Value.float(m.altitude_amsl) -> {[], position: height}
      true -> {[], position: Map.merge(height, %{lat: nil, lon: nil, alt_msl: nil, heading: nil})}
    end
  end

  defp height_apart?(state), do: Firmware.telemetry(state.autopilot).height_apart?
  defp known_height(state), do: Group.data(state, :position)[:alt_rel]

  defp heading(hdg) when hdg in 0..36_000, do: rem(hdg, 36_000) / 100
  defp heading(_unknown), do: nil
end
