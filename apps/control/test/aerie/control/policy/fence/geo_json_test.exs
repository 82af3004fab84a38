defmodule Aerie.Control.Policy.Fence.GeoJsonTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Geo.Earth
  alias Aerie.Control.Policy.Fence.{GeoJson, Zone}

  @square [[[8.0, 47.0], [8.1, 47.0], [8.1, 47.1], [8.0, 47.1], [8.0, 47.0]]]

  defp feature(geometry, properties \\ %{}),
    do: %{"type" => "Feature", "geometry" => geometry, "properties" => properties}

  defp square(properties \\ %{}), do: feature(%{"type" => "Polygon", "coordinates" => @square}, properties)
  defp collection(features), do: JSON.encode!(%{"type" => "FeatureCollection", "features" => features})

  defp zones(features) do
    {:ok, zones} = features |> collection() |> GeoJson.parse()
    zones
  end

  defp errors(features) do
    {:error, errors} = features |> collection() |> GeoJson.parse()
    errors
  end

  test "reads polygons, several polygons in one zone, and circles, with their properties" do
    [field, islands, tower] =
      zones([
        square(),
        feature(
          %{"type" => "MultiPolygon", "coordinates" => [@square, [[[9, 47], [9.1, 47], [9.1, 47.1]]]]},
          %{
            "name" => "islands",
            "min_altitude" => 10,
            "max_altitude" => 120.5,
            "altitude_reference" => "msl",
            "stroke" => "#ff0000"
          }
        ),
        feature(%{"type" => "Point", "coordinates" => [8.05, 47.05, 400]}, %{
          "fence" => "exclusion",
          "radius" => 50
        })
      ])

    assert %Zone{name: "zone 1", kind: :inclusion, floor: nil, ceiling: nil, reference: :home} = field

    assert %Zone{name: "islands", floor: 10, ceiling: 120.5, reference: :msl, polygons: [_one, _two]} =
             islands

    assert %Zone{name: "zone 3", kind: :exclusion} = tower
    assert Zone.over?(islands, Earth.point(47.03, 9.08))
    assert Zone.over?(tower, Earth.point(47.05, 8.0506))
    refute Zone.over?(tower, Earth.point(47.05, 8.0508))
  end

  test "a feature or a geometry alone is also a fence" do
    for alone <- [square(), %{"type" => "Polygon", "coordinates" => @square}],
        do: assert({:ok, [%Zone{}]} = alone |> JSON.encode!() |> GeoJson.parse())
  end

  test "gives all errors at once, each with its place" do
    assert errors([
             square(%{"fence" => "keep out", "max_altitude" => "120"}),
             feature(%{"type" => "LineString", "coordinates" => []}),
             feature(%{"type" => "Point", "coordinates" => [8, 47]}),
             feature(%{"type" => "Polygon", "coordinates" => [[[47, 8], [181.5, 95], [8, 1], ["8", 2]]]}),
             square(%{"min_altitude" => 50, "max_altitude" => 40}),
             square(%{"max_altitud" => 100}),
             square(%{"radius" => 4}),
             7
           ]) == [
             ~s|features[0].properties.fence: expected inclusion or exclusion, got: "keep out"|,
             ~s|features[0].properties.max_altitude: expected metres from -1000 to 100000, got: "120"|,
             ~s|features[1].geometry.type: expected Polygon, MultiPolygon, or Point with a radius, got: "LineString"|,
             ~s|features[2].properties.radius: expected metres, at least 1, got: nothing|,
             ~s|features[3].geometry.coordinates[0][1]: expected [longitude, latitude] in degrees, longitude first, got: [181.5,95]|,
             ~s|features[3].geometry.coordinates[0][3]: expected [longitude, latitude] in degrees, longitude first, got: ["8",2]|,
             ~s|features[4].properties.max_altitude: expected more than min_altitude (50), got: 40|,
             ~s|features[5].properties.max_altitud: expected a known property, got one that looks like "max_altitude"|,
             ~s|features[6].properties.radius: expected none, as it is for a Point|,
             ~s|features[7]: expected a Feature with a geometry, got: 7|
           ]
  end

  test "a member that looks as if it limited something is refused, wherever it stands" do
    point = %{"type" => "Point", "coordinates" => [8.05, 47.05]}

    for {properties, key} <- [
          {%{"type" => "exclusion"}, "type"},
          {%{"kind" => "No-Fly"}, "kind"},
          {%{"description" => "exclusion"}, "description"},
          {%{"exclusion" => true}, "exclusion"},
          {%{"inclusion" => false}, "inclusion"},
          {%{"Fence" => "exclusion"}, "Fence"},
          {%{"geofence" => "out"}, "geofence"},
          {%{"maxAltitude" => 30}, "maxAltitude"},
          {%{"max_alt" => 30}, "max_alt"},
          {%{"maxAlt" => 30}, "maxAlt"},
          {%{"MAXALT" => "30 m"}, "MAXALT"},
          {%{"ceiling" => 30}, "ceiling"},
          {%{"height" => 30}, "height"},
          {%{"upper_limit_m" => 30}, "upper_limit_m"},
          {%{"max" => 30}, "max"},
          {%{"altitude_ref" => "msl"}, "altitude_ref"},
          {%{"buffer" => 50}, "buffer"},
          {%{"allowed" => false}, "allowed"},
          {%{"aerie" => %{"fence" => "exclusion"}}, "aerie"},
          {%{"tags" => [%{"type" => "keep-out"}]}, "tags"}
        ] do
      assert [error] = errors([square(properties)])
      assert error =~ "features[0].properties.#{key}: expected "
    end

    assert ["features[0].fence: expected it in the properties of a Feature"] =
             errors([Map.put(square(), "fence", "exclusion")])

    assert ["features[0].geometry.max_altitude: expected it in the properties" <> _] =
             errors([put_in(square()["geometry"]["max_altitude"], 30)])

    assert ["features[0].properties.altitude_reference: expected min_altitude or max_altitude beside it" <> _] =
             errors([square(%{"altitude_reference" => "msl"})])

    for {more, place} <- [
          {%{"fence" => "exclusion"}, "fence"},
          {%{"properties" => %{"fence" => "exclusion"}}, "properties"}
        ] do
      for whole <- [
            %{"type" => "FeatureCollection", "features" => [square()]},
            %{"type" => "Polygon", "coordinates" => @square}
          ] do
        assert {:error, [error]} = whole |> Map.merge(more) |> JSON.encode!() |> GeoJson.parse()
        assert error =~ place <> ": expected "
      end
    end

    # What other programs write.
    assert [_zone] =
             zones([
               square(%{
                 "stroke" => "#f00",
                 "fill-opacity" => 0.5,
                 "marker-size" => "small",
                 "title" => "Field of the club",
                 "id" => 7,
                 "alt_name" => "Feld",
                 "note" => nil,
                 "tags" => ["a", %{"b" => 1}]
               })
               |> Map.put("id", "x")
             ])

    assert [_zone] = zones([feature(point, %{"radius" => 10})])
  end

  test "a member that stands twice is refused, and coordinates that are not degrees" do
    text = ~s({"type": "Polygon", "coordinates": #{JSON.encode!(@square)}, "type": "Polygon"})
    assert {:error, [~s(expected each member of an object once, got "type" twice)]} = GeoJson.parse(text)

    crs = fn name -> %{"type" => "name", "properties" => %{"name" => name}} end
    whole = %{"type" => "FeatureCollection", "features" => [square()]}

    assert {:error, ["crs: expected longitude" <> _]} =
             GeoJson.parse(JSON.encode!(Map.put(whole, "crs", crs.("EPSG:3857"))))

    assert {:ok, [_zone]} =
             GeoJson.parse(JSON.encode!(Map.put(whole, "crs", crs.("urn:ogc:def:crs:OGC:1.3:CRS84"))))
  end

  test "an exclusion zone that no vehicle of the inclusion zones can reach is refused" do
    swapped = [[[47.0, 8.0], [47.1, 8.0], [47.1, 8.1], [47.0, 8.1]]]

    exclusion =
      feature(%{"type" => "Polygon", "coordinates" => swapped}, %{"fence" => "exclusion", "name" => "tower"})

    assert {:error, [error]} = [square(), exclusion] |> collection() |> Aerie.Control.Policy.Fence.parse()
    assert error =~ "within 1000.0 km of an inclusion zone" and error =~ "tower"
    assert {:ok, _fence} = [exclusion] |> collection() |> Aerie.Control.Policy.Fence.parse()
  end

  test "what is not a GeoJSON is refused with its line, and a fence without zones" do
    assert {:error, ["line 3: expected JSON" <> _]} = GeoJson.parse("{\n\"type\":\n oops")
    assert {:error, ["line 1: expected JSON, got the end" <> _]} = GeoJson.parse("{")
    assert {:error, ["expected a GeoJSON FeatureCollection" <> _]} = GeoJson.parse("[]")
    assert {:error, ["features: expected at least one zone" <> _]} = GeoJson.parse(collection([]))
  end

  test "size, zones and positions are bounded" do
    assert {:error, ["expected at most 1048576 bytes" <> _]} = GeoJson.parse(String.duplicate(" ", 1_048_577))
    assert ["features: expected at most 100 zones, got: 101"] = errors(List.duplicate(square(), 101))
    ring = List.duplicate([8, 47], 2001)
    assert [text] = errors([feature(%{"type" => "Polygon", "coordinates" => [ring]})])
    assert text =~ "expected 3 to 2000 positions, got: 2001"

    assert ["expected at most 10000 positions, got: 10010"] =
             errors(
               for _zone <- 1..10,
                   do: feature(%{"type" => "Polygon", "coordinates" => [Enum.take(ring, 1001)]})
             )
  end

  test "any JSON gives zones or errors, never a crash" do
    leaf = :proper_types.oneof([nil, true, 8, 47.5, "Polygon", "Point", "Feature", "inclusion"])
    key = :proper_types.oneof(~w(type features geometry coordinates properties radius fence))

    object = fn below ->
      :proper_types.bind(:proper_types.list(:proper_types.tuple([key, below])), &Map.new/1, false)
    end

    small = :proper_types.oneof([leaf, :proper_types.list(leaf), object.(leaf)])
    json = :proper_types.oneof([small, :proper_types.list(small), object.(small)])

    property =
      :proper.forall(:proper_types.list(json), fn features ->
        features =
          for feature <- features, do: Map.merge(square(), if(is_map(feature), do: feature, else: %{}))

        match?({tag, [_ | _]} when tag in [:ok, :error], features |> collection() |> GeoJson.parse())
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
