defmodule Msp.Readings.Navigation do
  @moduledoc "What iNav's navigation does, its mission and its home: MISSION_CURRENT and HOME_POSITION."
  @behaviour Msp.Readings

  import Msp.Readings.Value

  alias MavCodec.Messages, as: M
  alias Msp.{Mission, Readings}

  # The mode of NAV_STATUS; MISSION_STATE
  @nav_mission 3
  @mission_not_started 2
  @mission_active 3

  @impl Readings
  def polls do
    [
      {"NAV_STATUS", %{}, [inav: 500], []},
      {"WP_GETINFO", %{}, [inav: 5000], []},
      {"WP", %{number: 0}, [inav: 2500], []}
    ]
  end

  @impl Readings
  def read(:inav, "NAV_STATUS", %{mode: mode, wp_number: number}, _ids),
    do: %{nav_mode: mode, waypoint: number}

  def read(:inav, "WP_GETINFO", %{count: count}, _ids), do: %{waypoints: count}

  def read(:inav, "WP", %{number: 0, lat: lat, lon: lon, altitude: cm}, _ids) do
    if lat == 0 and lon == 0, do: %{home: nil}, else: %{home: {lat / 1.0e7, lon / 1.0e7, cm / 100}}
  end

  def read(:inav, "WP", %{number: 255, lat: lat, lon: lon, altitude: cm}, _ids),
    do: %{here_msl: if(lat != 0 or lon != 0, do: cm / 100)}

  def read(_firmware, _name, _values, _ids), do: %{}

  @impl Readings
  def messages("NAV_STATUS", readings, context), do: mission(readings, context.aboard)
  def messages("WP", readings, _context), do: home(readings)
  def messages(_name, _readings, _context), do: []

  # It counts its waypoints from 1. A mission that was read also has items.
  defp mission(%{waypoints: count, waypoint: number, nav_mode: mode}, known) when count > 0 do
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

  defp mission(_readings, _known), do: []

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
end
