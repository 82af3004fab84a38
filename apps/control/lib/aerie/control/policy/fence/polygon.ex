defmodule Aerie.Control.Policy.Fence.Polygon do
  @moduledoc """
  An area of the earth's surface with a straight-edged border and holes, ready to be asked.

  Its border is straight in latitude and longitude, as GeoJSON, ArduPilot and PX4 have it; of the two ways around the earth
  an edge takes the shorter one. The area is mapped onto a plane of its own by the gnomonic projection, in which great
  circles are straight. An edge that is not one (long, and far from the equator) is cut until it lies within
  5 cm of its great circle. Paths of vehicles are taken as great circles. For a vehicle that flies straight in latitude and
  longitude the error is at most `L² · tan(latitude) / 8R`: 3 cm on 1 km and 3.4 m on 10 km at 60°.
  """

  alias Aerie.Base.Geo.Earth

  @enforce_keys [:centre, :north, :east, :box, :edges]
  defstruct @enforce_keys

  # Beyond it the plane is too distorted to be exact; no fence needs to be so large.
  @max_radius 1_500_000
  @off_m 0.05
  @max_edges 20_000
  @corners 256
  # Cosine of 60 degrees: further away is outside, whatever the radius.
  @near 0.5

  @type position :: {lon :: number(), lat :: number()}
  @type t :: %__MODULE__{
          centre: Earth.vector(),
          north: Earth.vector(),
          east: Earth.vector(),
          box: {float(), float(), float(), float()},
          edges: [edge()]
        }
  @typep edge :: {float(), float(), float(), float()}

  @doc """
  The area of a GeoJSON Polygon: rings of positions, the first is the border, the others are holes. The last position of a
  ring may repeat the first.
  """
  @spec new([[position()]]) :: {:ok, t()} | {:error, String.t()}
  def new(rings) do
    with {:ok, rings} <- all(rings, &ring/1),
         corners = Enum.concat(rings),
         {:ok, centre} <- centre(corners),
         {:ok, rings} <- all(rings, &cut/1) do
      build(centre, rings)
    end
  end

  @doc """
  A circle, `metres` around a position, as a polygon that never errs to the unsafe side: `:inner` lies within the circle,
  `:outer` around it. They differ from it by at most 75 millionths of the radius.
  """
  @spec circle(position(), number(), :inner | :outer) :: {:ok, t()} | {:error, String.t()}
  def circle(_middle, metres, _side) when metres > @max_radius / 2,
    do: {:error, "expected a radius of at most #{div(@max_radius, 2)} m, got: #{metres} m"}

  def circle({lon, lat}, metres, side) do
    middle = Earth.point(lat, lon)
    reach = if side == :inner, do: metres, else: metres / :math.cos(:math.pi() / @corners)
    build(middle, [for(n <- 0..(@corners - 1), do: Earth.destination(middle, n * 360 / @corners, reach))])
  end

  @doc "Whether a point is inside. A point on the border may be either."
  @spec inside?(t(), Earth.vector()) :: boolean()
  def inside?(polygon, point) do
    case project(polygon, point) do
      {x, y} -> boxed?(polygon.box, x, y) and odd?(polygon.edges, x, y, false)
      :far -> false
    end
  end

  @doc """
  Where a way crosses or touches the border, as shares 0..1 of the straight line between the two points. The way must be
  shorter than #{div(@max_radius, 1000)} km.
  """
  @spec crossings(t(), Earth.vector(), Earth.vector()) :: [float()]
  def crossings(polygon, from, to) do
    with {x1, y1} <- project(polygon, from),
         {x2, y2} <- project(polygon, to),
         true <- meets?(polygon.box, x1, y1, x2, y2) do
      {near, far} = {Earth.dot(from, polygon.centre), Earth.dot(to, polygon.centre)}

      for share <- cross(polygon.edges, x1, y1, x2 - x1, y2 - y1, []) do
        # From the share of the way in the plane to that of the line in space.
        share / far / ((1 - share) / near + share / far)
      end
    else
      _too_far -> []
    end
  end

  @doc "The border and the holes for a drawing, each as its corners in degrees."
  @spec rings(t()) :: [[{lat :: float(), lon :: float()}]]
  def rings(polygon) do
    # An edge begins where the one before it of the same ring ends.
    polygon.edges
    |> Enum.chunk_while(
      [],
      fn
        {_, _, _, _} = edge, [] -> {:cont, [edge]}
        {x, y, _, _} = edge, [{_, _, x, y} | _] = ring -> {:cont, [edge | ring]}
        edge, ring -> {:cont, Enum.reverse(ring), [edge]}
      end,
      &{:cont, Enum.reverse(&1), []}
    )
    |> Enum.map(fn ring -> for {x, y, _, _} <- ring, do: polygon |> lift({x, y}) |> Earth.degrees() end)
  end

  @doc "Metres from a point to the border; `:far` for more than the plane can tell."
  @spec distance(t(), Earth.vector()) :: float() | :far
  def distance(polygon, point) do
    with {x, y} <- project(polygon, point) do
      {_squared, nearest} = polygon.edges |> Enum.map(&foot(&1, x, y)) |> Enum.min()
      Earth.distance(point, lift(polygon, nearest))
    end
  end

  @doc "Metres from a way to the border, 0 where they meet; `:far` for more than the plane can tell."
  @spec clearance(t(), Earth.vector(), Earth.vector()) :: float() | :far
  def clearance(polygon, from, to) do
    with {x1, y1} <- project(polygon, from),
         {x2, y2} <- project(polygon, to) do
      way = {x1, y1, x2, y2}

      if cross(polygon.edges, x1, y1, x2 - x1, y2 - y1, []) != [],
        do: 0.0,
        else: polygon.edges |> Enum.map(&between(&1, way)) |> Enum.min() |> :math.sqrt()
    end
  end

  # The square of the distance between two lines that do not cross: from an end of one of them.
  defp between({x1, y1, x2, y2} = edge, {x3, y3, x4, y4} = way) do
    ends = [foot(edge, x3, y3), foot(edge, x4, y4), foot(way, x1, y1), foot(way, x2, y2)]
    ends |> Enum.map(&elem(&1, 0)) |> Enum.min()
  end

  defp ring(positions) do
    ring = if List.first(positions) == List.last(positions), do: Enum.drop(positions, 1), else: positions
    ring = ring |> Enum.map(fn {lon, lat} -> {normal(lon), lat} end) |> Enum.dedup()
    if length(ring) >= 3, do: {:ok, ring}, else: {:error, "expected at least three different positions"}
  end

  # One number for each meridian.
  defp normal(lon) when lon >= 180, do: normal(lon - 360)
  defp normal(lon) when lon < -180, do: normal(lon + 360)
  defp normal(lon), do: lon

  defp centre(corners) do
    points = for {lon, lat} <- corners, do: Earth.point(lat, lon)
    sum = Enum.reduce(points, &Earth.plus/2)

    with true <- Earth.norm(sum) > 1.0,
         centre = Earth.surface(sum),
         true <- Enum.all?(points, &(Earth.distance(centre, &1) <= @max_radius)) do
      {:ok, centre}
    else
      false -> {:error, "expected all positions within #{div(@max_radius, 1000)} km of their middle"}
    end
  end

  # The points of a ring, closed, with as many more on its edges as make them great circles.
  defp cut(ring) do
    [{_lon, _lat} = first | _] = ring

    edges =
      Enum.zip_with(ring, Enum.drop(ring, 1) ++ [first], fn {lon1, lat1}, {lon2, lat2} ->
        {{lon1, lat1}, {lon1 + shorter(lon2 - lon1), lat2}}
      end)

    if Enum.any?(edges, &half_around?/1),
      do: {:error, "expected no edge halfway around the earth: add a position between its ends"},
      else: {:ok, Enum.flat_map(edges, &pieces/1)}
  end

  defp shorter(degrees), do: degrees - 360 * Float.round(degrees / 360)

  # At a pole all longitudes are one point.
  defp half_around?({{lon1, lat1}, {lon2, lat2}}),
    do: abs(lon2 - lon1) >= 180 and (abs(lat1) < 90 or abs(lat2) < 90)

  # The start of an edge and the points on it, not its end.
  defp pieces({{lon1, lat1} = from, {lon2, lat2} = to}) do
    {first, last} = {Earth.point(lat1, lon1), Earth.point(lat2, lon2)}
    middle = {(lon1 + lon2) / 2, (lat1 + lat2) / 2}
    {lon, lat} = middle

    # The quarters too: an edge that goes through the equator is straight in its middle.
    off =
      for share <- [0.25, 0.5, 0.75] do
        there = Earth.point(lat1 + (lat2 - lat1) * share, lon1 + (lon2 - lon1) * share)
        aside(there, first, last)
      end

    if Enum.max([aside(Earth.point(lat, lon), first, last) | off]) <= @off_m,
      do: [first],
      else: pieces({from, middle}) ++ pieces({middle, to})
  end

  # Metres between a point and the great circle through two others.
  defp aside(point, first, last) do
    # Both ends at a pole have no great circle between them.
    if Earth.distance(first, last) < 0.001,
      do: Earth.distance(point, first),
      else: first |> Earth.cross(last) |> Earth.unit() |> Earth.dot(point) |> abs()
  end

  defp build(centre, rings) do
    {north, east} = Earth.tangents(centre)
    plane = %__MODULE__{centre: Earth.unit(centre), north: north, east: east, box: {0, 0, 0, 0}, edges: []}
    rings = Enum.map(rings, fn ring -> Enum.map(ring, &project(plane, &1)) end)
    edges = Enum.flat_map(rings, &Enum.zip(&1, tl(&1) ++ [hd(&1)]))
    edges = uncut(for {{x1, y1}, {x2, y2}} <- edges, {x1, y1} != {x2, y2}, do: {x1, y1, x2, y2})
    {xs, ys} = rings |> Enum.concat() |> Enum.unzip()
    polygon = %{plane | edges: edges, box: {Enum.min(xs), Enum.min(ys), Enum.max(xs), Enum.max(ys)}}

    cond do
      length(edges) > @max_edges ->
        {:error,
         "expected edges that are shorter, or nearer to the equator: they make #{length(edges)} pieces"}

      edges == [] ->
        {:error, "expected an area, but the border goes the same way back"}

      crossing = self_crossing(edges) || touching(edges) ->
        {x, y} = crossing
        {lat, lon} = polygon |> lift({x, y}) |> Earth.degrees()

        {:error,
         "expected edges that do not cross or touch each other, but two do near longitude #{Float.round(lon, 6)}, " <>
           "latitude #{Float.round(lat, 6)}"}

      not holes_within?(rings) ->
        {:error, "expected holes inside the border"}

      true ->
        {:ok, polygon}
    end
  end

  defp holes_within?([border | holes]) do
    outline = for {{x1, y1}, {x2, y2}} <- Enum.zip(border, tl(border) ++ [hd(border)]), do: {x1, y1, x2, y2}
    Enum.all?(holes, fn [{x, y} | _] -> odd?(outline, x, y, false) end)
  end

  # An area around a pole may be cut open along a meridian, down one side and up the other: nothing ends there.
  defp uncut(edges) do
    all = MapSet.new(edges)
    Enum.reject(edges, fn {x1, y1, x2, y2} -> MapSet.member?(all, {x2, y2, x1, y1}) end)
  end

  # A corner at which more than two edges end, to the millimetre.
  defp touching(edges) do
    edges
    |> Enum.flat_map(fn {x1, y1, x2, y2} -> [{x1, y1}, {x2, y2}] end)
    |> Enum.group_by(fn {x, y} -> {round(x * 1000), round(y * 1000)} end)
    |> Enum.find_value(fn {_near, ends} -> if length(ends) > 2, do: hd(ends) end)
  end

  # Edges sorted by their left end meet only those that begin before they end.
  defp self_crossing(edges) do
    edges
    |> Enum.sort_by(fn {x1, _y1, x2, _y2} -> min(x1, x2) end)
    |> first_crossing()
  end

  defp first_crossing([]), do: nil

  defp first_crossing([edge | rest]) do
    {x1, _y1, x2, _y2} = edge
    meeting(edge, rest, max(x1, x2)) || first_crossing(rest)
  end

  defp meeting(_edge, [], _right), do: nil

  defp meeting(edge, [{x1, _, x2, _} = other | rest], right) do
    cond do
      min(x1, x2) > right -> nil
      properly?(edge, other) -> {elem(other, 0), elem(other, 1)}
      true -> meeting(edge, rest, right)
    end
  end

  # Both ends of each clearly on different sides of the other; neighbours share an end and do not count.
  defp properly?({ax, ay, bx, by} = one, {cx, cy, dx, dy} = other) do
    opposed?(side(one, cx, cy), side(one, dx, dy)) and opposed?(side(other, ax, ay), side(other, bx, by))
  end

  defp opposed?(a, b), do: (a > 1.0e-6 and b < -1.0e-6) or (a < -1.0e-6 and b > 1.0e-6)

  # Metres to the left of an edge.
  defp side({x1, y1, x2, y2}, x, y) do
    {dx, dy} = {x2 - x1, y2 - y1}
    (dx * (y - y1) - dy * (x - x1)) / :math.sqrt(dx * dx + dy * dy)
  end

  defp project(%{centre: centre, north: north, east: east}, point) do
    depth = Earth.dot(point, centre)

    if depth > @near * 6.3e6 do
      scale = 6_371_008.8 / depth
      {Earth.dot(point, east) * scale, Earth.dot(point, north) * scale}
    else
      :far
    end
  end

  defp lift(%{centre: centre, north: north, east: east}, {x, y}) do
    centre
    |> Earth.scale(6_371_008.8)
    |> Earth.plus(Earth.plus(Earth.scale(east, x), Earth.scale(north, y)))
    |> Earth.surface()
  end

  defp boxed?({left, bottom, right, top}, x, y), do: x >= left and x <= right and y >= bottom and y <= top

  defp meets?({left, bottom, right, top}, x1, y1, x2, y2) do
    max(x1, x2) >= left and min(x1, x2) <= right and max(y1, y2) >= bottom and min(y1, y2) <= top
  end

  defp odd?([], _x, _y, odd), do: odd

  defp odd?([{x1, y1, x2, y2} | rest], x, y, odd) when y1 > y != y2 > y do
    crosses = x < (x2 - x1) * (y - y1) / (y2 - y1) + x1
    odd?(rest, x, y, crosses != odd)
  end

  defp odd?([_edge | rest], x, y, odd), do: odd?(rest, x, y, odd)

  defp cross([], _x, _y, _dx, _dy, found), do: found

  defp cross([{x1, y1, x2, y2} | rest], x, y, dx, dy, found) do
    {ex, ey} = {x2 - x1, y2 - y1}
    across = dx * ey - dy * ex

    if across == 0.0 do
      # Parallel; where it runs along the edge, the edge's neighbours are crossed.
      cross(rest, x, y, dx, dy, found)
    else
      {fx, fy} = {x1 - x, y1 - y}
      way = (fx * ey - fy * ex) / across
      edge = (fx * dy - fy * dx) / across

      if way >= 0 and way <= 1 and edge >= 0 and edge <= 1,
        do: cross(rest, x, y, dx, dy, [way | found]),
        else: cross(rest, x, y, dx, dy, found)
    end
  end

  # The nearest point of an edge.
  defp foot({x1, y1, x2, y2}, x, y) do
    {dx, dy} = {x2 - x1, y2 - y1}
    square = dx * dx + dy * dy
    share = if square == 0.0, do: 0.0, else: ((x - x1) * dx + (y - y1) * dy) / square
    share = share |> max(0.0) |> min(1.0)
    {px, py} = {x1 + share * dx, y1 + share * dy}
    {(px - x) * (px - x) + (py - y) * (py - y), {px, py}}
  end

  defp all(items, fun) do
    Enum.reduce_while(items, {:ok, []}, fn item, {:ok, done} ->
      case fun.(item) do
        {:ok, result} -> {:cont, {:ok, [result | done]}}
        error -> {:halt, error}
      end
    end)
    |> then(fn result -> with {:ok, done} <- result, do: {:ok, Enum.reverse(done)} end)
  end
end
