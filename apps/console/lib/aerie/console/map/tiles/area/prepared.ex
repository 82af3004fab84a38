defmodule Aerie.Console.Map.Tiles.Area.Prepared do
  @moduledoc "The areas whose tiles were fetched, as `map.json` lists them, the newest first. Pure."

  @most 20

  @typedoc "`at`: when it was done, unix microseconds, by which it is named; `box`: west, south, east, north."
  @type t :: %{at: integer(), layer: String.t(), box: [number()], zoom: 0..24, tiles: pos_integer()}

  @doc "The areas of the file's JSON."
  @spec read(term()) :: {:ok, [t()]} | :error
  def read(nil), do: {:ok, []}

  def read(listed) when is_list(listed) and length(listed) <= @most do
    areas = for %{} = one <- listed, area = one(one), do: area
    if length(areas) == length(listed), do: {:ok, areas}, else: :error
  end

  def read(_other), do: :error

  defp one(%{"at" => at, "layer" => layer, "box" => [_, _, _, _] = box, "zoom" => zoom, "tiles" => tiles})
       when is_integer(at) and is_binary(layer) and zoom in 0..24 and is_integer(tiles) do
    if Enum.all?(box, &is_number/1), do: %{at: at, layer: layer, box: box, zoom: zoom, tiles: tiles}
  end

  defp one(_other), do: nil

  @doc "One more, in place of the same one prepared before; beyond 20 the oldest goes."
  @spec add([t()], t()) :: [t()]
  def add(areas, area) do
    same? = &(Map.take(&1, [:layer, :box, :zoom]) == Map.take(area, [:layer, :box, :zoom]))
    Enum.take([area | Enum.reject(areas, same?)], @most)
  end
end
