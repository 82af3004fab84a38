defmodule Aerie.Replay.Stations do
  @moduledoc """
  Who else sends heartbeats in a recording: what `Aerie.Router.Stations` is to a live gateway, as a value. At most 1,024;
  one that was not heard for ten minutes makes room for a new one.
  """

  alias Aerie.Router.Stations
  alias Aerie.Mavlink.Heartbeat
  alias MavCodec.Frame

  @max 1_024
  @forget_us 600_000_000

  @type t :: %{{non_neg_integer, 0..255} => Stations.station()}

  @doc "Notes the heartbeat of something that is no vehicle, heard by a link."
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

    if is_map_key(stations, key) or map_size(stations) < @max,
      do: Map.put(stations, key, station),
      else: stations
  end

  defp room(stations, _now) when map_size(stations) < @max, do: stations

  defp room(stations, now),
    do: Map.filter(stations, fn {_key, station} -> station.last_heard >= now - @forget_us end)

  @doc "All of them, in an order that depends on nothing else."
  @spec list(t) :: [Stations.station()]
  def list(stations), do: stations |> Enum.sort() |> Enum.map(&elem(&1, 1))
end
