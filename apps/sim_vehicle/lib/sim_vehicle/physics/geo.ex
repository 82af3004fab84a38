defmodule SimVehicle.Physics.Geo do
  @moduledoc """
  Flat-earth conversion between latitude/longitude in degrees x 1e7 and metres north/east of an origin.

  Good to centimetres within the few kilometres that a simulated vehicle flies; it is the same approximation
  (a fixed metres-per-degree, longitude scaled by the cosine of the origin's latitude) that ArduPilot uses.
  """

  @metres_per_e7 0.011131884502145034
  @pole 900_000_000
  @turn 3_600_000_000
  @int32 2_147_483_647

  @typedoc "Latitude and longitude in degrees x 1e7, altitude in metres above mean sea level."
  @type origin :: %{lat: integer, lon: integer, alt: float}

  @doc "Metres north and east of `origin` for a position in degrees x 1e7."
  @spec to_local(origin, integer, integer) :: {float, float}
  def to_local(origin, lat, lon) do
    {(lat - origin.lat) * @metres_per_e7, wrap_e7(lon - origin.lon) * @metres_per_e7 * scale(origin)}
  end

  @doc "Position in degrees x 1e7 of a point `north`/`east` metres from `origin`."
  @spec to_global(origin, number, number) :: {integer, integer}
  def to_global(origin, north, east) do
    lat = origin.lat + round(north / @metres_per_e7)
    lon = origin.lon + round(east / (@metres_per_e7 * scale(origin)))
    {lat |> max(-@pole) |> min(@pole), wrap_e7(lon)}
  end

  @doc "Metres as the millimetres of a 32-bit field; cut off where they do not fit."
  @spec millimetres(number) :: integer
  def millimetres(metres), do: (metres * 1000.0) |> max(-@int32) |> min(@int32) |> round()

  @doc "Angle brought to -pi..pi."
  @spec wrap_pi(float) :: float
  def wrap_pi(angle) do
    turned = :math.fmod(angle + :math.pi(), 2 * :math.pi())
    if turned < 0, do: turned + :math.pi(), else: turned - :math.pi()
  end

  @doc "Heading in centidegrees, 0..35999, of an angle in radians."
  @spec centidegrees(float) :: 0..35_999
  def centidegrees(angle), do: Integer.mod(round(angle * 18_000 / :math.pi()), 36_000)

  @doc "True when the point lies inside the polygon (list of `{north, east}`, at least three corners)."
  @spec inside?([{float, float}], {float, float}) :: boolean
  def inside?(corners, {n, e}) do
    corners
    |> Enum.zip(tl(corners) ++ [hd(corners)])
    |> Enum.count(fn {{n1, e1}, {n2, e2}} ->
      e1 > e != e2 > e and n < (n2 - n1) * (e - e1) / (e2 - e1) + n1
    end)
    |> rem(2) == 1
  end

  # Never zero, so that a vehicle at a pole does not divide by it.
  defp scale(origin), do: max(:math.cos(origin.lat * 1.0e-7 * :math.pi() / 180), 0.01)

  defp wrap_e7(lon) when lon in -1_800_000_000..1_800_000_000, do: lon
  defp wrap_e7(lon), do: Integer.mod(lon + div(@turn, 2), @turn) - div(@turn, 2)
end
