defmodule Aerie.Console.Map.Zones do
  @moduledoc "The policy's zones for the map: the payload of `map:zones`. Pure."

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Fence.Polygon

  @doc "The zones of a policy; `[]` without a policy or a fence."
  @spec of(Policy.t() | nil) :: [map()]
  def of(%Policy{fence: %{zones: zones}}),
    do:
      for(
        zone <- zones,
        polygon <- zone.polygons,
        do: %{kind: zone.kind, name: zone.name, rings: rings(polygon)}
      )

  def of(_none), do: []

  defp rings(polygon) do
    for ring <- Polygon.rings(polygon) do
      for {lat, lon} <- ring, do: [Float.round(lat, 7), Float.round(lon, 7)]
    end
  end
end
