defmodule Aerie.Control.Mission.OwnFence.Area do
  @moduledoc """
  A zone of a plan's fence on a map of metres around the fence's first place, as both firmwares judge it: polygons by even and odd
  crossings, the border of a circle inside. Pure.
  """

  alias Protocols.Mission.Plan

  @metres_per_degree 111_319.5

  @enforce_keys [:number, :kind, :shape, :box, :origin]
  defstruct @enforce_keys

  @type point :: {x :: float(), y :: float()}
  @typedoc "`number` of the zone in the plan, from 1; `origin` in degrees; `box`: the least and the greatest x and y."
  @type t :: %__MODULE__{
          number: pos_integer(),
          kind: :inclusion | :exclusion,
          shape: {:polygon, [point(), ...]} | {:circle, point(), float()},
          box: {point(), point()},
          origin: {float(), float()}
        }

  @doc "The areas of a fence."
  @spec all([Plan.zone(), ...]) :: [t()]
  def all([first | _] = zones) do
    origin = first |> elem(1) |> origin() |> degrees()

    for {{kind, shape}, number} <- Enum.with_index(zones, 1) do
      shape = flat(shape, origin)
      %__MODULE__{number: number, kind: kind, shape: shape, box: box(shape), origin: origin}
    end
  end

  defp origin({:polygon, [corner | _]}), do: corner
  defp origin({:circle, centre, _radius}), do: centre

  defp flat({:polygon, corners}, origin),
    do: {:polygon, Enum.map(corners, &(&1 |> degrees() |> metres(origin)))}

  defp flat({:circle, centre, radius}, origin), do: {:circle, centre |> degrees() |> metres(origin), radius}

  defp degrees({lat, lon}), do: {lat / 1.0e7, lon / 1.0e7}

  defp metres({lat, lon}, {lat0, lon0}) do
    # The shorter way around the earth.
    east = :math.fmod(lon - lon0 + 540.0, 360.0) - 180.0
    {east * @metres_per_degree * :math.cos(lat0 * :math.pi() / 180), (lat - lat0) * @metres_per_degree}
  end

  defp box({:circle, {x, y}, radius}), do: {{x - radius, y - radius}, {x + radius, y + radius}}

  defp box({:polygon, corners}) do
    {west, east} = corners |> Enum.map(&elem(&1, 0)) |> Enum.min_max()
    {south, north} = corners |> Enum.map(&elem(&1, 1)) |> Enum.min_max()
    {{west, south}, {east, north}}
  end

  @doc "Whether a place, in degrees, is inside."
  @spec inside?(t(), {number(), number()}) :: boolean()
  def inside?(area, {lat, lon}), do: covers?(area, metres({lat / 1, lon / 1}, area.origin))

  defp covers?(%{shape: {:circle, centre, radius}}, point), do: distance(centre, point) <= radius

  defp covers?(%{shape: {:polygon, corners}, box: box}, point),
    do: within?(box, point) and corners |> sides() |> Enum.count(&crosses?(&1, point)) |> rem(2) == 1

  defp within?({{west, south}, {east, north}}, {x, y}),
    do: x >= west and x <= east and y >= south and y <= north

  # The side crosses the ray from the point to the east.
  defp crosses?({{x1, y1}, {x2, y2}}, {x, y}),
    do: y1 > y != y2 > y and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1

  @doc """
  Where the straight way between two places, in degrees, meets the area's border: shares of the way from 0 to 1, in no
  order. Between two of them the way is inside or outside as a whole.
  """
  @spec crossings(t(), {number(), number()}, {number(), number()}) :: [float()]
  def crossings(area, {lat1, lon1}, {lat2, lon2}) do
    from = metres({lat1 / 1, lon1 / 1}, area.origin)
    to = metres({lat2 / 1, lon2 / 1}, area.origin)
    if boxes?(area.box, box({:polygon, [from, to]})), do: met(area.shape, from, to), else: []
  end

  defp met({:polygon, corners}, from, to) do
    for {a, b} = side <- sides(corners), cut?(side, {from, to}), do: share(turn(a, b, from), turn(a, b, to))
  end

  # |from + share * (to - from) - centre| = radius
  defp met({:circle, {cx, cy}, radius}, {x1, y1}, {x2, y2}) do
    {dx, dy, fx, fy} = {x2 - x1, y2 - y1, x1 - cx, y1 - cy}
    {a, b} = {dx * dx + dy * dy, fx * dx + fy * dy}
    root = b * b - a * (fx * fx + fy * fy - radius * radius)

    if a == 0.0 or root < 0.0,
      do: [],
      else: for(sign <- [-1, 1], at = (-b + sign * :math.sqrt(root)) / a, at >= 0.0 and at <= 1.0, do: at)
  end

  # Both are 0 where the way lies on the side.
  defp share(one, two), do: if(one == two, do: 0.0, else: one / (one - two))

  @doc "Whether two areas have no place in common."
  @spec apart?(t(), t()) :: boolean()
  def apart?(one, two), do: not boxes?(one.box, two.box) or not meet?(one, two)

  defp boxes?({{w1, s1}, {e1, n1}}, {{w2, s2}, {e2, n2}}), do: w1 <= e2 and w2 <= e1 and s1 <= n2 and s2 <= n1

  defp meet?(%{shape: {:circle, a, r}}, %{shape: {:circle, b, s}}), do: distance(a, b) <= r + s

  defp meet?(%{shape: {:circle, centre, radius}}, %{shape: {:polygon, corners}} = polygon),
    do: covers?(polygon, centre) or corners |> sides() |> Enum.any?(&(from_side(&1, centre) <= radius))

  defp meet?(%{shape: {:polygon, _corners}} = polygon, %{shape: {:circle, _, _}} = circle),
    do: meet?(circle, polygon)

  defp meet?(%{shape: {:polygon, [a | _] = one}} = first, %{shape: {:polygon, [b | _] = two}} = second) do
    covers?(first, b) or covers?(second, a) or
      Enum.any?(sides(one), fn side -> Enum.any?(sides(two), &cut?(side, &1)) end)
  end

  defp sides([first | rest] = corners), do: Enum.zip(corners, rest ++ [first])

  defp cut?({a, b}, {c, d}), do: turn(a, b, c) * turn(a, b, d) <= 0 and turn(c, d, a) * turn(c, d, b) <= 0

  defp turn({x1, y1}, {x2, y2}, {x, y}), do: (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1)

  defp from_side({{x1, y1}, {x2, y2}} = side, {x, y}) do
    {dx, dy} = {x2 - x1, y2 - y1}
    square = dx * dx + dy * dy

    share =
      if square == 0.0, do: 0.0, else: (((x - x1) * dx + (y - y1) * dy) / square) |> max(0.0) |> min(1.0)

    {from, _to} = side
    distance({elem(from, 0) + share * dx, elem(from, 1) + share * dy}, {x, y})
  end

  defp distance({x1, y1}, {x2, y2}), do: :math.sqrt((x2 - x1) * (x2 - x1) + (y2 - y1) * (y2 - y1))
end
