defmodule Aerie.Console.Map.ZonesTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Fence
  alias Aerie.Console.Map.Zones

  test "a zone is drawn with its border and its holes, corner by corner" do
    border = [[8.0, 47.0], [8.01, 47.0], [8.01, 47.01], [8.0, 47.01], [8.0, 47.0]]
    hole = [[8.004, 47.004], [8.006, 47.004], [8.005, 47.006], [8.004, 47.004]]

    {:ok, fence} =
      Fence.parse(
        JSON.encode!(%{
          type: "FeatureCollection",
          features: [
            %{
              type: "Feature",
              properties: %{name: "field", fence: "inclusion"},
              geometry: %{type: "Polygon", coordinates: [border, hole]}
            }
          ]
        })
      )

    assert [%{kind: :inclusion, name: "field", rings: [outer, inner]}] =
             Zones.of(%{policy() | fence: fence})

    assert Enum.sort(outer) == Enum.sort(for [lon, lat] <- tl(border), do: [lat, lon])
    assert Enum.sort(inner) == Enum.sort(for [lon, lat] <- tl(hole), do: [lat, lon])
  end

  test "no fence, no zones" do
    assert Zones.of(nil) == []
    assert Zones.of(policy()) == []
  end

  defp policy, do: Policy.__struct__()
end
