defmodule Aerie.Base.Geo.Earth do
  @moduledoc """
  Points on the WGS 84 ellipsoid as vectors from its centre, in metres. Vectors have no antimeridian and no poles, so
  nothing that is built on them needs a special case for either.
  """

  @a 6_378_137.0
  @b 6_356_752.314245179
  @e2 1 - @b * @b / (@a * @a)
  @mean 6_371_008.8
  @degree :math.pi() / 180

  @type vector :: {float(), float(), float()}

  @doc "The point at a latitude and a longitude in degrees, height 0."
  @spec point(number(), number()) :: vector()
  def point(lat, lon) do
    {sin, cos} = {:math.sin(lat * @degree), :math.cos(lat * @degree)}
    n = @a / :math.sqrt(1 - @e2 * sin * sin)
    {n * cos * :math.cos(lon * @degree), n * cos * :math.sin(lon * @degree), n * (1 - @e2) * sin}
  end

  @doc "The point of the surface in the direction of a vector."
  @spec surface(vector()) :: vector()
  def surface({x, y, z} = vector),
    do: scale(vector, 1 / :math.sqrt((x * x + y * y) / (@a * @a) + z * z / (@b * @b)))

  @doc """
  Metres between two points along the surface. Within 2 cm up to 100 km, within 1 % up to the other side of the earth.
  """
  @spec distance(vector(), vector()) :: float()
  def distance(from, to) do
    chord = from |> minus(to) |> norm()
    2 * @mean * :math.asin(min(chord / (2 * @mean), 1.0))
  end

  @doc "The point that lies so many metres from another one, in a direction in degrees from north."
  @spec destination(vector(), number(), number()) :: vector()
  def destination(from, bearing, metres) do
    {north, east} = tangents(from)

    ahead =
      plus(scale(north, :math.cos(bearing * @degree)), scale(east, :math.sin(bearing * @degree)))

    up = unit(from)

    # A step on a sphere, corrected until its length is right on the ellipsoid.
    step = fn length ->
      angle = length / @mean
      surface(plus(scale(up, :math.cos(angle)), scale(ahead, :math.sin(angle))))
    end

    length =
      Enum.reduce(1..3, metres, fn _time, length -> length * metres / distance(from, step.(length)) end)

    step.(length)
  end

  @doc "Two directions at right angles to a point and to each other, north and east (anything at a pole)."
  @spec tangents(vector()) :: {vector(), vector()}
  def tangents({x, y, _z} = point) do
    axis = if x * x + y * y < 1.0, do: {0.0, 1.0, 0.0}, else: {0.0, 0.0, 1.0}
    east = unit(cross(axis, point))
    {unit(cross(point, east)), east}
  end

  @doc "Latitude and longitude of a point of the surface, in degrees."
  @spec degrees(vector()) :: {lat :: float(), lon :: float()}
  def degrees({x, y, z}) do
    flat = :math.sqrt(x * x + y * y) * (1 - @e2)
    {:math.atan2(z, flat) / @degree, :math.atan2(y, x) / @degree}
  end

  @doc "A point on the way between two points: 0 is the first, 1 the second."
  @spec between(vector(), vector(), number()) :: vector()
  def between(from, to, share), do: from |> scale(1 - share) |> plus(scale(to, share)) |> surface()

  @spec dot(vector(), vector()) :: number()
  def dot({a, b, c}, {x, y, z}), do: a * x + b * y + c * z

  @spec unit(vector()) :: vector()
  def unit(vector), do: scale(vector, 1 / norm(vector))

  @spec plus(vector(), vector()) :: vector()
  def plus({a, b, c}, {x, y, z}), do: {a + x, b + y, c + z}

  @spec scale(vector(), number()) :: vector()
  def scale({x, y, z}, by), do: {x * by, y * by, z * by}

  @spec norm(vector()) :: float()
  def norm(vector), do: :math.sqrt(dot(vector, vector))

  @spec cross(vector(), vector()) :: vector()
  def cross({a, b, c}, {x, y, z}), do: {b * z - c * y, c * x - a * z, a * y - b * x}

  defp minus({a, b, c}, {x, y, z}), do: {a - x, b - y, c - z}
end
