defmodule Aerie.Console.Pages.Plan.Profile do
  @moduledoc "The height profile of a mission along its path, for a drawing. Pure. The ground elevation is not known."

  alias Protocols.Mission.{Item, Plan}
  alias Aerie.Base.Geo.Earth

  # Frames with heights above mean sea level; in the others they are above home, or above the ground.
  @msl [0, 5]
  @terrain [10, 11]

  @typedoc "`metres` along the path from the first position; `height` above home, nil if it cannot be known; `ground?`: given above the ground."
  @type point :: %{index: non_neg_integer(), metres: float(), height: float() | nil, ground?: boolean()}

  @doc "The points of a plan's mission that have a position, in order."
  @spec points(Plan.t()) :: [point()]
  def points(%Plan{} = plan) do
    home = with {_position, altitude} <- plan.home, do: altitude
    placed = for {item, index} <- Enum.with_index(plan.items), Item.flown?(item), do: {item, index}

    {points, _last} =
      Enum.map_reduce(placed, {nil, 0.0}, fn {item, index}, {from, metres} ->
        here = Earth.point(item.x / 1.0e7, item.y / 1.0e7)
        metres = if from, do: metres + Earth.distance(from, here), else: metres
        point = %{index: index, metres: metres, height: height(item, home), ground?: item.frame in @terrain}
        {point, {here, metres}}
      end)

    points
  end

  @doc "The length of the path over the ground in metres."
  @spec metres([point()]) :: float()
  def metres([]), do: 0.0
  def metres(points), do: List.last(points).metres

  defp height(%{z: nil}, _home), do: nil
  defp height(%{frame: frame}, nil) when frame in @msl, do: nil
  defp height(%{frame: frame, z: z}, home) when frame in @msl, do: z - home
  defp height(%{z: z}, _home), do: z

  @doc """
  The drawing in a box of `width` by `height`: the line's points for SVG, the dots, and the limits of the scale; nil without two
  heights.
  """
  @spec drawing([point()], pos_integer(), pos_integer()) ::
          %{line: String.t(), dots: [map()], low: float(), high: float(), length: float()} | nil
  def drawing(points, width, height) do
    known = for %{height: h} = point <- points, h != nil, do: point

    if length(known) >= 2 do
      {low, high} = known |> Enum.map(& &1.height) |> Enum.min_max()
      {low, high} = {min(low, 0.0), max(high, low + 1.0)}
      all = max(metres(points), 1.0)

      dots =
        for point <- known do
          x = Float.round(point.metres / all * width, 1)
          %{index: point.index, x: x, y: Float.round((high - point.height) / (high - low) * height, 1)}
        end

      %{line: Enum.map_join(dots, " ", &"#{&1.x},#{&1.y}"), dots: dots, low: low, high: high, length: all}
    end
  end
end
