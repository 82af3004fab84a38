defmodule Aerie.Control.Policy.Fence.GeoJson do
  @moduledoc """
  Reads a fence from GeoJSON (RFC 7946): a FeatureCollection, one Feature or one geometry. Each Polygon and MultiPolygon is a
  zone; a Point with a `radius` is a circle.

  | property | |
  |---|---|
  | `fence` | `inclusion` (default) or `exclusion` |
  | `name` | what refusals call it; `zone 1` … if left out |
  | `radius` | of a Point, metres |
  | `min_altitude`, `max_altitude` | the band of heights that the zone is about, metres; all heights if left out |
  | `altitude_reference` | what they are above: `home` (default) or `msl` |

  Other properties are left to other programs, but for those that look as if they limited something
  (`Aerie.Control.Policy.Fence.Foreign`): a limit that is not read is worse than none. All errors are given at once, each with its place in the file.
  """

  alias Aerie.Control.Policy.Fence.{Foreign, Json, Polygon, Zone}

  @max_bytes 1_048_576
  @max_zones 100
  @max_positions 10_000
  @max_ring 2_000
  @keys Foreign.keys()
  # The only coordinates of GeoJSON; older files may still say so.
  @wgs84 ~w(urn:ogc:def:crs:OGC:1.3:CRS84 urn:ogc:def:crs:OGC::CRS84 OGC:CRS84 EPSG:4326 urn:ogc:def:crs:EPSG::4326)

  @doc "The largest file in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The zones of a text. Errors are lines such as `features[2].properties.radius: expected …, got …`."
  @spec parse(binary()) :: {:ok, [Zone.t(), ...]} | {:error, [String.t(), ...]}
  def parse(text) when byte_size(text) > @max_bytes,
    do: {:error, ["expected at most #{@max_bytes} bytes, got: #{byte_size(text)}"]}

  def parse(text) do
    with {:ok, json} <- decode(text),
         {:ok, features} <- features(json),
         :ok <- members(json),
         :ok <- count(features) do
      features |> Enum.with_index(1) |> Enum.map(&feature/1) |> collect()
    end
  end

  defp decode(text), do: with({:error, line} <- Json.decode(text), do: {:error, [line]})

  defp features(%{"type" => "FeatureCollection", "features" => features}) when is_list(features),
    do: {:ok, for({feature, n} <- Enum.with_index(features), do: {"features[#{n}]", feature})}

  defp features(%{"type" => "Feature"} = feature), do: {:ok, [{"", feature}]}

  defp features(%{"type" => type} = geometry) when type in ~w(Polygon MultiPolygon Point),
    do: {:ok, [{"", %{"type" => "Feature", "geometry" => geometry, "properties" => %{}}}]}

  defp features(other) do
    {:error, ["expected a GeoJSON FeatureCollection, Feature, Polygon or MultiPolygon, got: #{got(other)}"]}
  end

  # Beside features and geometries nothing is read.
  defp members(%{"crs" => %{"properties" => %{"name" => name}}} = json) when name in @wgs84,
    do: json |> Map.delete("crs") |> members()

  defp members(%{"crs" => crs}) when crs != nil,
    do: {:error, ["crs: expected longitude and latitude (WGS 84), got: #{got(crs)}"]}

  defp members(%{"type" => "FeatureCollection"} = json),
    do: foreign(json, ~w(type features bbox crs), & &1)

  defp members(%{"type" => "Feature"}), do: :ok
  defp members(geometry), do: foreign(geometry, ~w(type coordinates bbox crs), & &1)

  defp foreign(object, own, at) do
    case Foreign.problems(object, own, at, false) do
      [] -> :ok
      errors -> {:error, errors}
    end
  end

  defp count([]),
    do:
      {:error, ["features: expected at least one zone, got none: a fence without zones would fence nothing"]}

  defp count(features) when length(features) > @max_zones,
    do: {:error, ["features: expected at most #{@max_zones} zones, got: #{length(features)}"]}

  defp count(features) do
    case features |> Enum.map(fn {_path, feature} -> positions(feature) end) |> Enum.sum() do
      few when few <= @max_positions -> :ok
      many -> {:error, ["expected at most #{@max_positions} positions, got: #{many}"]}
    end
  end

  defp positions(%{"geometry" => %{"coordinates" => coordinates}}), do: leaves(coordinates)
  defp positions(_other), do: 0

  defp leaves([[_ | _] | _] = list), do: list |> Enum.map(&leaves/1) |> Enum.sum()
  defp leaves(_position), do: 1

  defp feature({{path, %{"type" => "Feature", "geometry" => %{} = geometry} = feature}, n}) do
    case feature["properties"] || %{} do
      %{} = properties ->
        {zone, errors} = properties(path, properties, n)
        beside = Foreign.problems(feature, ~w(type geometry properties id bbox crs), &join(path, &1), false)

        inside =
          Foreign.problems(geometry, ~w(type coordinates bbox crs), &join(path, "geometry.#{&1}"), false)

        errors = Enum.reverse(beside ++ inside) ++ errors
        geometry(join(path, "geometry"), geometry, properties, zone, errors)

      other ->
        {:error, ["#{join(path, "properties")}: expected an object, got: #{got(other)}"]}
    end
  end

  defp feature({{path, other}, _n}),
    do: {:error, ["#{path}: expected a Feature with a geometry, got: #{got(other)}"]}

  defp properties(path, properties, n) do
    at = &join(path, "properties.#{&1}")

    {kind, errors} =
      one_of(at, properties, "fence", %{"inclusion" => :inclusion, "exclusion" => :exclusion}, [])

    {reference, errors} =
      one_of(at, properties, "altitude_reference", %{"home" => :home, "msl" => :msl}, errors)

    {name, errors} = name(at, properties["name"], "zone #{n}", errors)
    {floor, errors} = height(at, properties, "min_altitude", errors)
    {ceiling, errors} = height(at, properties, "max_altitude", errors)

    errors =
      if floor && ceiling && floor >= ceiling,
        do: ["#{at.("max_altitude")}: expected more than min_altitude (#{floor}), got: #{ceiling}" | errors],
        else: errors

    unread = properties |> Foreign.problems(@keys, at, true) |> Enum.reverse()

    errors =
      if Map.has_key?(properties, "fence") or unread != [],
        do: errors,
        else: undecided(at, properties) ++ errors

    heights? = Map.has_key?(properties, "min_altitude") or Map.has_key?(properties, "max_altitude")

    errors =
      if Map.has_key?(properties, "altitude_reference") and not heights?,
        do: [
          "#{at.("altitude_reference")}: expected min_altitude or max_altitude beside it, got neither"
          | errors
        ],
        else: errors

    zone = %Zone{
      name: name,
      kind: kind,
      polygons: [],
      floor: floor,
      ceiling: ceiling,
      reference: reference
    }

    {zone, unread ++ errors}
  end

  defp undecided(at, properties) do
    for {key, value} <- properties, Foreign.excludes?(value) do
      "#{at.("fence")}: expected inclusion or exclusion, because #{key} is #{got(value)}, got: nothing"
    end
  end

  # The first of the values is the default.
  defp one_of(at, properties, key, values, errors) do
    default = if key == "fence", do: :inclusion, else: :home

    case Map.fetch(properties, key) do
      :error ->
        {default, errors}

      {:ok, text} when is_map_key(values, text) ->
        {values[text], errors}

      {:ok, other} ->
        names = values |> Map.keys() |> Enum.sort(:desc) |> Enum.join(" or ")
        {default, ["#{at.(key)}: expected #{names}, got: #{got(other)}" | errors]}
    end
  end

  defp name(_at, nil, default, errors), do: {default, errors}

  defp name(_at, name, _default, errors) when is_binary(name) and byte_size(name) in 1..64,
    do: {name, errors}

  defp name(at, other, default, errors),
    do: {default, ["#{at.("name")}: expected a text of at most 64 bytes, got: #{got(other)}" | errors]}

  defp height(at, properties, key, errors) do
    case Map.fetch(properties, key) do
      :error ->
        {nil, errors}

      {:ok, metres} when is_number(metres) and metres >= -1000 and metres <= 100_000 ->
        {metres, errors}

      {:ok, other} ->
        {nil, ["#{at.(key)}: expected metres from -1000 to 100000, got: #{got(other)}" | errors]}
    end
  end

  defp geometry(path, %{"type" => "Point"} = geometry, properties, zone, errors) do
    {radius, errors} =
      case properties["radius"] do
        metres when is_number(metres) and metres >= 1 ->
          {metres, errors}

        other ->
          {nil, ["#{sibling(path)}radius: expected metres, at least 1, got: #{got(other)}" | errors]}
      end

    side = if zone.kind == :inclusion, do: :inner, else: :outer

    with {:ok, position} <- position(join(path, "coordinates"), geometry["coordinates"]),
         [] <- errors,
         {:ok, polygon} <- with_path(sibling(path) <> "radius", Polygon.circle(position, radius, side)) do
      {:ok, %{zone | polygons: [polygon]}}
    else
      {:error, more} -> {:error, Enum.reverse(errors) ++ more}
      errors -> {:error, Enum.reverse(errors)}
    end
  end

  defp geometry(path, %{"type" => type} = geometry, properties, zone, errors)
       when type in ~w(Polygon MultiPolygon) do
    errors =
      if is_map_key(properties, "radius"),
        do: ["#{sibling(path)}radius: expected none, as it is for a Point" | errors],
        else: errors

    path = join(path, "coordinates")
    coordinates = geometry["coordinates"]

    polygons =
      cond do
        not is_list(coordinates) or coordinates == [] ->
          [{:error, ["#{path}: expected a list of rings, got: #{got(coordinates)}"]}]

        type == "Polygon" ->
          [polygon(path, coordinates)]

        true ->
          for {polygon, n} <- Enum.with_index(coordinates), do: polygon("#{path}[#{n}]", polygon)
      end

    case {Enum.reverse(errors), collect(polygons)} do
      {[], {:ok, polygons}} -> {:ok, %{zone | polygons: polygons}}
      {errors, {:ok, _polygons}} -> {:error, errors}
      {errors, {:error, more}} -> {:error, errors ++ more}
    end
  end

  defp geometry(path, geometry, _properties, _zone, errors) do
    {:error,
     Enum.reverse([
       "#{join(path, "type")}: expected Polygon, MultiPolygon, or Point with a radius, got: #{got(geometry["type"])}"
       | errors
     ])}
  end

  defp polygon(path, rings) when is_list(rings) and rings != [] do
    with {:ok, rings} <-
           rings
           |> Enum.with_index()
           |> Enum.map(fn {ring, n} -> ring("#{path}[#{n}]", ring) end)
           |> collect() do
      with_path(path, Polygon.new(rings))
    end
  end

  defp polygon(path, other), do: {:error, ["#{path}: expected a list of rings, got: #{got(other)}"]}

  defp ring(path, [_, _, _ | _] = ring) when length(ring) <= @max_ring do
    ring
    |> Enum.with_index()
    |> Enum.map(fn {position, n} -> position("#{path}[#{n}]", position) end)
    |> collect()
  end

  defp ring(path, ring) when is_list(ring) do
    {:error, ["#{path}: expected 3 to #{@max_ring} positions, got: #{length(ring)}"]}
  end

  defp ring(path, other), do: {:error, ["#{path}: expected a list of positions, got: #{got(other)}"]}

  # Some programs write longitudes beyond 180 for what lies across the antimeridian.
  defp position(_path, [lon, lat | _height])
       when is_number(lon) and is_number(lat) and lon >= -360 and lon <= 360 and lat >= -90 and lat <= 90,
       do: {:ok, {lon, lat}}

  defp position(path, other) do
    {:error, ["#{path}: expected [longitude, latitude] in degrees, longitude first, got: #{got(other)}"]}
  end

  defp with_path(_path, {:ok, polygon}), do: {:ok, polygon}
  defp with_path(path, {:error, text}), do: {:error, ["#{path}: #{text}"]}

  defp collect(results) do
    case for({:error, errors} <- results, error <- errors, do: error) do
      [] -> {:ok, for({:ok, result} <- results, do: result)}
      errors -> {:error, errors}
    end
  end

  defp join("", key), do: key
  defp join(path, key), do: "#{path}.#{key}"

  # A property of the feature whose geometry a path leads to.
  defp sibling(path), do: String.replace_suffix(path, "geometry", "properties.")

  defp got(nil), do: "nothing"
  defp got(value) when is_map(value) and is_map_key(value, "type"), do: got(value["type"])

  defp got(value) do
    text = JSON.encode!(value)
    if byte_size(text) > 60, do: String.slice(text, 0, 57) <> "…", else: text
  end
end
