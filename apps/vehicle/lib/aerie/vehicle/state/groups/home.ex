defmodule Aerie.Vehicle.State.Groups.Home do
  @moduledoc "The home position, and the origin of local coordinates."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Messages, as: M

  use Group,
    name: :home,
    title: "The home position.",
    sampling: {:change, 1.0, %{}, 60.0},
    messages: [M.HomePosition, M.GpsGlobalOrigin],
    fields: [
      {:lat, 7, "°", "latitude", "HOME_POSITION", -90..90},
      {:lon, 7, "°", "longitude", "HOME_POSITION", -180..180},
      {:alt_msl, 2, "m", "height above mean sea level", "HOME_POSITION"}
    ]

  # PX4 accepts a home position at 95 degrees north, and publishes it.
  @impl Group
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
end
