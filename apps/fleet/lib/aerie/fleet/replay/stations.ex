defmodule Aerie.Fleet.Replay.Stations do
  @moduledoc """
  The other senders of heartbeats in a recording: `MavRouter.Forward.GroundStations` as a value, with the same limits.
  """

  alias MavRouter.Forward.GroundStations
  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Frame

  @type t :: %{{non_neg_integer, 0..255} => GroundStations.station()}

  @doc "Notes a heartbeat of something that is not a vehicle."
  @spec hear(t, Frame.t(), Heartbeat.t(), String.t()) :: t
  def hear(stations, frame, heartbeat, link) do
    key = {frame.system, frame.component}

    station = %{
      system: frame.system,
      component: frame.component,
      type: heartbeat.type,
      via: link,
      last_heard: frame.at
    }

    stations = if is_map_key(stations, key), do: stations, else: room(stations, frame.at)

    if is_map_key(stations, key) or map_size(stations) < GroundStations.max(),
      do: Map.put(stations, key, station),
      else: stations
  end

  defp room(stations, now) do
    if map_size(stations) < GroundStations.max(),
      do: stations,
      else:
        Map.filter(stations, fn {_key, station} -> station.last_heard >= now - GroundStations.forget_us() end)
  end

  @doc "All stations, sorted by their ids."
  @spec list(t) :: [GroundStations.station()]
  def list(stations), do: stations |> Enum.sort() |> Enum.map(&elem(&1, 1))
end
