defmodule Aerie.Control.Policy.Fence.PolygonTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Geo.Earth
  alias Aerie.Control.Policy.Fence.Polygon

  @oracle Path.expand("../../../../fixtures/fence_oracle.json", __DIR__)

  defp polygon(rings) do
    {:ok, polygon} = Polygon.new(for ring <- rings, do: Enum.map(ring, &List.to_tuple/1))
    polygon
  end

  test "answers as shapely does, across the antimeridian too" do
    for %{"rings" => rings, "points" => points, "ways" => ways} <- @oracle |> File.read!() |> JSON.decode!() do
      polygon = polygon(rings)

      for [lon, lat, inside?] <- points,
          do: assert(Polygon.inside?(polygon, Earth.point(lat, lon)) == inside?, inspect({rings, lon, lat}))

      # All of them begin inside.
      for [lon1, lat1, lon2, lat2, stays?] <- ways do
        crossings = Polygon.crossings(polygon, Earth.point(lat1, lon1), Earth.point(lat2, lon2))
        assert crossings == [] == stays?, inspect({rings, lon1, lat1, lon2, lat2})
        assert Enum.all?(crossings, &(&1 >= 0 and &1 <= 1))
      end
    end
  end

  # How often the border goes around the point, seen from above it: knows nothing of planes, poles and antimeridians.
  defp winding(ring, {lon, lat}) do
    point = Earth.point(lat, lon)
    {north, east} = Earth.tangents(point)

    seen = fn {lon, lat} ->
      there = Earth.point(lat, lon)
      :math.atan2(Earth.dot(there, east), Earth.dot(there, north))
    end

    ring
    |> Enum.zip(tl(ring) ++ [hd(ring)])
    |> Enum.flat_map(fn {{lon1, lat1}, {lon2, lat2}} ->
      across = lon2 - lon1 - 360 * Float.round((lon2 - lon1) / 360)
      for n <- 0..39, do: seen.({lon1 + across * n / 40, lat1 + (lat2 - lat1) * n / 40})
    end)
    |> then(&Enum.zip(&1, tl(&1) ++ [hd(&1)]))
    |> Enum.map(fn {a, b} -> :math.fmod(b - a + 5 * :math.pi(), 2 * :math.pi()) - :math.pi() end)
    |> Enum.sum()
    |> Kernel./(2 * :math.pi())
    |> round()
    |> abs()
  end

  test "any area of any size anywhere, poles and antimeridian included, has inside what its border goes around" do
    corner = :proper_types.tuple([:proper_types.float(0.05, 0.95), :proper_types.float(0.3, 1.0)])

    area =
      :proper_types.tuple([
        :proper_types.float(-180.0, 180.0),
        :proper_types.oneof([:proper_types.float(-90.0, 90.0), :proper_types.float(86.0, 90.0), -89.0]),
        :proper_types.oneof([300.0, 20_000.0, 900_000.0]),
        :proper_types.vector(7, corner),
        :proper_types.vector(
          8,
          :proper_types.tuple([:proper_types.float(0.0, 360.0), :proper_types.float(0.0, 1.6)])
        )
      ])

    property =
      :proper.forall(area, fn {lon, lat, reach, corners, points} ->
        middle = Earth.point(lat, lon)

        at = fn bearing, metres ->
          middle |> Earth.destination(bearing, metres) |> Earth.degrees() |> swap()
        end

        ring =
          for {{offset, far}, n} <- Enum.with_index(corners),
              do: at.((n + offset) * 360 / length(corners), far * reach)

        case Polygon.new([ring]) do
          {:ok, polygon} ->
            Enum.all?(points, fn {bearing, far} ->
              {lon, lat} = at.(bearing, far * reach + 1.0)
              point = Earth.point(lat, lon)
              # The brute force sees the border in steps of a fortieth of an edge.
              near? = Polygon.distance(polygon, point) < reach / 25
              near? or Polygon.inside?(polygon, point) == (winding(ring, {lon, lat}) == 1)
            end)

          # Drawn around a pole, straight edges may cross.
          {:error, text} ->
            text =~ "cross or touch each other" or text =~ "halfway"
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
  end

  defp swap({lat, lon}), do: {lon, lat}

  test "areas around a pole, in both ways of writing them" do
    ring = polygon([[[0, 80], [90, 80], [180, 80], [-90, 80]]])
    # As maps have it, cut open along the antimeridian.
    cut = polygon([[[-180, 90], [-180, 80], [-90, 80], [0, 80], [90, 80], [180, 80], [180, 90], [-180, 90]]])

    for polygon <- [ring, cut] do
      for {lat, lon} <- [{90, 0}, {89.9, 179.9}, {80.1, -45}, {80.1, 45}, {85, 0.001}],
          do: assert(Polygon.inside?(polygon, Earth.point(lat, lon)))

      for {lat, lon} <- [{79.9, 0}, {79.9, 180}, {0, 0}, {-90, 0}],
          do: refute(Polygon.inside?(polygon, Earth.point(lat, lon)))

      assert Polygon.crossings(polygon, Earth.point(85, 10), Earth.point(85, -170)) == []
      assert [_out] = Polygon.crossings(polygon, Earth.point(85, 10), Earth.point(78, 10))
    end
  end

  test "the border is straight in latitude and longitude: its long edge follows the parallel, not the great circle" do
    # The great circle between the two corners at 60 degrees goes 8.5 km north of the parallel in its middle.
    polygon = polygon([[[0, 60], [5, 60], [5, 58], [0, 58]]])
    assert Polygon.inside?(polygon, Earth.point(59.999, 2.5))
    refute Polygon.inside?(polygon, Earth.point(60.001, 2.5))
    assert_in_delta Polygon.distance(polygon, Earth.point(60.001, 2.5)), 111.4, 0.2
  end

  test "distances are those of geodesy" do
    # Flinders Peak to Buninyong, the test case of Vincenty's paper in WGS 84.
    flinders = Earth.point(-37.95103341666667, 144.42486788888888)
    buninyong = Earth.point(-37.65282113888889, 143.92649552777777)
    assert_in_delta Earth.distance(flinders, buninyong), 54_972.271, 0.01
    there = Earth.destination(flinders, 306.868, 1000)
    assert_in_delta Earth.distance(flinders, there), 1000, 1.0e-6
  end

  test "circles are exact to 75 millionths and err to the safe side" do
    for {lat, lon} <- [{47.4, 8.5}, {0, 180}, {-90, 0}, {89.999, 10}], radius <- [5, 1000, 100_000] do
      {:ok, inner} = Polygon.circle({lon, lat}, radius, :inner)
      {:ok, outer} = Polygon.circle({lon, lat}, radius, :outer)
      middle = Earth.point(lat, lon)

      for bearing <- [0.7, 45.35, 133, 270.1] do
        on = &Earth.destination(middle, bearing, &1)
        assert Polygon.inside?(inner, on.(radius * 0.99992))
        refute Polygon.inside?(inner, on.(radius * 1.000001))
        assert Polygon.inside?(outer, on.(radius * 0.999999))
        refute Polygon.inside?(outer, on.(radius * 1.00008))
      end
    end
  end

  test "what is not an area is refused with a reason" do
    for {rings, words} <- [
          {[[{0, 0}, {1, 1}]], "three different positions"},
          {[[{0, 0}, {1, 1}, {0, 0}]], "three different positions"},
          {[[{0, 0}, {1, 1}, {1, 0}, {0, 1}]], "do not cross or touch each other"},
          {[[{0, 0}, {1, 0}, {1, 1}, {0, 1}], [{2, 2}, {3, 2}, {3, 3}]], "holes inside the border"},
          {[[{0, 0}, {1, 0}, {1, 1}, {0, 1}], [{0.5, 0.5}, {3, 0.5}, {3, 0.6}]],
           "do not cross or touch each other"},
          {[[{0, 0}, {60, 0}, {60, 40}, {0, 40}]], "within 1500 km"},
          {[[{0, 85}, {180, 85}, {90, 89}]], "halfway around the earth"},
          {[[{0, 0}, {90, 0}, {180, 0}, {-90, 0}]], "within 1500 km"}
        ] do
      assert {:error, text} = Polygon.new(rings)
      assert text =~ words
    end
  end
end
