defmodule Aerie.Console.Pages.Plan.MapPayload do
  @moduledoc "A draft as the map draws it: the payload of `map:plan`. Pure."

  alias Aerie.Console.Pages.Plan.{Check, Draft, Edit, Kinds}
  alias Protocols.Mission.Item

  @doc "The payload without `map`."
  @spec payload(Draft.t(), [Check.problem()]) :: map()
  def payload(%Draft{plan: plan} = draft, problems) do
    wrong = for %{part: :mission, index: index} when index != nil <- problems, into: MapSet.new(), do: index

    %{
      part: Atom.to_string(draft.part),
      home: with({position, _altitude} <- plan.home, do: place(position)),
      items:
        for {item, n} <- Enum.with_index(plan.items) do
          Map.merge(item_place(item), %{
            text: Integer.to_string(n + 1),
            picked: picked?(draft, :mission, n),
            problem: n in wrong
          })
        end,
      zones:
        for(
          {zone, n} <- Enum.with_index(plan.fence),
          do: Map.put(zone(zone), :picked, picked?(draft, :fence, n))
        ),
      corners: Enum.map(draft.corners, &pair/1),
      rally:
        for {{position, _altitude}, n} <- Enum.with_index(plan.rally) do
          Map.put(place(position), :picked, picked?(draft, :rally, n))
        end
    }
  end

  @doc "The plan aboard a vehicle as the map draws it: a plan of `map:plans`, without its vehicle."
  @spec aboard(Protocols.Mission.Plan.t()) :: map()
  def aboard(plan) do
    places =
      for {item, n} <- Enum.with_index(plan.items, 1),
          %{lat: lat, lon: lon} when lat != nil <- [item_place(item)],
          do: [lat, lon, n]

    rally = for {{lat, lon}, _altitude} <- plan.rally, do: pair({lat, lon})
    %{mission: places, fences: Enum.map(plan.fence, &zone/1), rally: rally}
  end

  @doc "A zone as the map draws it."
  @spec zone(Protocols.Mission.Plan.zone()) :: map()
  def zone({kind, {:polygon, corners}}), do: %{kind: kind, ring: Enum.map(corners, &pair/1)}
  def zone({kind, {:circle, centre, radius}}), do: %{kind: kind, centre: pair(centre), radius: radius}

  @doc "A zone that is still being drawn, to be kept by the browser (`Draft.resume/2`)."
  @spec open([Protocols.Mission.Plan.position()], term()) :: map()
  def open(corners, fence), do: %{shape: Edit.shape(fence), corners: Enum.map(corners, &pair/1)}

  defp picked?(%{part: part, picked: {index, _corner}}, part, index), do: true
  defp picked?(_draft, _part, _index), do: false

  # Both firmwares take 0, 0 for the present position.
  defp item_place(%{x: x, y: y} = item) when is_integer(x) and is_integer(y) and {x, y} != {0, 0} do
    if Item.flown?(item) or item.command in Kinds.looks(),
      do: place({x, y}),
      else: %{lat: nil}
  end

  defp item_place(_item), do: %{lat: nil}

  defp place({lat, lon}), do: %{lat: lat / 1.0e7, lon: lon / 1.0e7}
  defp pair({lat, lon}), do: [lat / 1.0e7, lon / 1.0e7]
end
