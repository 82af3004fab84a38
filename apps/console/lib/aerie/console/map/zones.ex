defmodule Aerie.Console.Map.Zones do
  @moduledoc "The policy's zones for the map: the payload of `map:zones`. Pure."

  alias Aerie.Control.Policy

  @doc "The zones of a policy; `[]` without a policy or a fence."
  @spec of(Policy.t() | nil) :: [map()]
  def of(policy) do
    for zone <- Policy.zones(policy), do: %{zone | rings: Enum.map(zone.rings, &ring/1)}
  end

  defp ring(ring), do: for({lat, lon} <- ring, do: [Float.round(lat, 7), Float.round(lon, 7)])
end
