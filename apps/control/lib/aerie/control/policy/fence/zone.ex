defmodule Aerie.Control.Policy.Fence.Zone do
  @moduledoc """
  One zone of a fence: where vehicles must be (`:inclusion`) or must not be (`:exclusion`), at all heights or within a band
  of them. `reference` says what `floor` and `ceiling` are metres above: `:home` or `:msl` (mean sea level).
  """

  alias Aerie.Base.Geo.Earth
  alias Aerie.Control.Policy.Fence.Polygon

  @enforce_keys [:name, :kind, :polygons]
  defstruct [:name, :kind, :polygons, :floor, :ceiling, reference: :home]

  @type t :: %__MODULE__{
          name: String.t(),
          kind: :inclusion | :exclusion,
          polygons: [Polygon.t(), ...],
          floor: number() | nil,
          ceiling: number() | nil,
          reference: :home | :msl
        }

  @typedoc "A place with its heights in metres, nil where they are not known."
  @type place :: %{point: Earth.vector(), home: number() | nil, msl: number() | nil}

  @doc """
  Whether a place is in the zone. Where its height is not known, the zone's band decides against the vehicle: it is in
  an exclusion zone and in no inclusion zone.
  """
  @spec covers?(t(), place()) :: boolean()
  def covers?(zone, place), do: band?(zone, place) and over?(zone, place.point)

  @doc "Whether a point is in the zone's area, whatever its height."
  @spec over?(t(), Earth.vector()) :: boolean()
  def over?(zone, point), do: Enum.any?(zone.polygons, &Polygon.inside?(&1, point))

  @doc "Whether a place's height is in the zone's band."
  @spec band?(t(), place()) :: boolean()
  def band?(%{floor: nil, ceiling: nil}, _place), do: true

  def band?(zone, place) do
    case Map.fetch!(place, zone.reference) do
      nil -> zone.kind == :exclusion
      height -> height >= (zone.floor || height) and height <= (zone.ceiling || height)
    end
  end

  @doc "Where a straight way enters or leaves the zone, as shares 0..1 of it."
  @spec crossings(t(), place(), place()) :: [float()]
  def crossings(zone, from, to) do
    heights = {Map.fetch!(from, zone.reference), Map.fetch!(to, zone.reference)}

    Enum.flat_map(zone.polygons, &Polygon.crossings(&1, from.point, to.point)) ++
      for(limit <- [zone.floor, zone.ceiling], limit != nil, share <- passing(limit, heights), do: share)
  end

  @doc "Metres from a point to the nearest border of the zone; `:far` beyond the range of the projection."
  @spec distance(t(), Earth.vector()) :: float() | :far
  def distance(zone, point), do: zone.polygons |> Enum.map(&Polygon.distance(&1, point)) |> Enum.min()

  @doc "Metres from a straight way to the nearest border of the zone; `:far` beyond the range of the projection."
  @spec clearance(t(), place(), place()) :: float() | :far
  def clearance(zone, from, to),
    do: zone.polygons |> Enum.map(&Polygon.clearance(&1, from.point, to.point)) |> Enum.min()

  defp passing(limit, {from, to}) when is_number(from) and is_number(to) and from != to do
    share = (limit - from) / (to - from)
    if share > 0 and share < 1, do: [share], else: []
  end

  defp passing(_limit, _level_or_unknown), do: []
end
