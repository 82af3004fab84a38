defmodule Aerie.Control.Policy.Fence.Kept do
  @moduledoc """
  Whether a fence of a vehicle keeps the vehicle at least where another one kept it. It errs to one side: `false`
  where that is not certain. Pure.

  ArduPilot wants the vehicle in all stay-inside zones, PX4 and ArduPilot with an option in one of them. So each
  zone of the new fence has to lie in one of the old fence, and each of the old fence has to have one in it.
  """

  alias Aerie.Control.Policy.Fence.Polygon
  alias Aerie.Base.Geo.Earth
  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.Vehicle.Firmware

  # Pairs of zones that are compared; of more only equal ones count.
  @most_pairs 400

  @doc "Whether the items of a new fence keep what those of the old one kept."
  @spec by?(new :: [Item.t()], old :: [Item.t()]) :: boolean()
  def by?(_new, []), do: true

  def by?(new, old) do
    with false <- Enum.map(new, &place/1) == Enum.map(old, &place/1),
         %{fence: new, fence_others: []} <- zones(new),
         %{fence: old, fence_others: []} <- zones(old) do
      compare? = length(new) * length(old) <= @most_pairs
      {new_in, new_out} = Enum.split_with(new, &inclusion?/1)
      {old_in, old_out} = Enum.split_with(old, &inclusion?/1)

      Enum.all?(old_out, fn zone -> Enum.any?(new_out, &within?(zone, &1, compare?)) end) and
        Enum.all?(old_in, fn zone -> Enum.any?(new_in, &within?(&1, zone, compare?)) end) and
        (old_in == [] or Enum.all?(new_in, fn zone -> Enum.any?(old_in, &within?(zone, &1, compare?)) end))
    else
      same_or_not_understood -> same_or_not_understood == true
    end
  end

  # What makes a zone; vehicles keep frames and heights of fences otherwise than they were sent.
  defp place(item), do: {item.command, elem(item.params, 0), item.x, item.y}

  defp zones(items), do: Onboard.put(%Plan{}, 1, items, Firmware.of(:generic))

  defp inclusion?({kind, _shape}), do: kind == :inclusion

  # Whether the first zone lies in the second one.
  defp within?({_kind, shape}, {_same_kind, shape}, _compare?), do: true
  defp within?(_inner, _outer, false), do: false

  defp within?({_kind, inner}, {_same_kind, outer}, true) do
    with {:ok, inner} <- polygon(inner, :outer),
         {:ok, outer} <- polygon(outer, :inner) do
      [corners] = Polygon.rings(inner)
      corners = for {lat, lon} <- corners, do: Earth.point(lat, lon)
      sides = Enum.zip(corners, tl(corners) ++ [hd(corners)])

      Polygon.inside?(outer, hd(corners)) and
        Enum.all?(sides, fn {from, to} -> Polygon.crossings(outer, from, to) == [] end)
    else
      {:error, _not_an_area} -> false
    end
  end

  defp polygon({:polygon, corners}, _side),
    do: Polygon.new([for({lat, lon} <- corners, do: {lon / 1.0e7, lat / 1.0e7})])

  defp polygon({:circle, {lat, lon}, metres}, side),
    do: Polygon.circle({lon / 1.0e7, lat / 1.0e7}, metres, side)
end
