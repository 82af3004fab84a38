defmodule Aerie.Control.Policy.Fence do
  @moduledoc """
  The zones that vehicles must stay in and those that they must keep out of, as a value.

  A place is allowed if it is in at least one inclusion zone (where there are any) and in no exclusion zone. A way is
  allowed if every point of it is. A vehicle that is already where it must not be may be sent out of there: the part of
  the way before it first comes back does not count.
  """

  alias Aerie.Base.Geo.Earth
  alias Aerie.Control.Policy.Fence.{GeoJson, Zone}
  alias Aerie.Vehicle.Command.Refusal

  @enforce_keys [:zones]
  defstruct @enforce_keys

  @type t :: %__MODULE__{zones: [Zone.t(), ...]}

  @typedoc "A position in degrees, with its heights in metres above home and above mean sea level, nil where not known."
  @type position :: %{lat: number(), lon: number(), home: number() | nil, msl: number() | nil}
  @type room :: %{:metres => number(), :why => String.t(), optional(atom()) => term()}

  # No vehicle of a gateway flies farther, and the map of a zone would distort a longer way.
  @max_way 1_000_000

  @doc "The fence of a GeoJSON text, or all that is wrong with it."
  @spec parse(binary()) :: {:ok, t()} | {:error, [String.t(), ...]}
  def parse(text) do
    with {:ok, zones} <- GeoJson.parse(text), [] <- astray(zones) do
      {:ok, %__MODULE__{zones: zones}}
    else
      {:error, errors} -> {:error, errors}
      errors -> {:error, errors}
    end
  end

  # Nothing that is in an inclusion zone gets there: longitude and latitude are swapped, most likely.
  defp astray(zones) do
    with [_ | _] = inclusions <- inclusions(zones) do
      for %{kind: :exclusion} = zone <- zones, Enum.any?(zone.polygons, &far_from_all?(&1, inclusions)) do
        ~s(expected exclusion zones within #{km(@max_way)} of an inclusion zone, got: "#{zone.name}", which is farther away ) <>
          "(longitude comes before latitude)"
      end
    end
  end

  defp far_from_all?(%{centre: centre}, inclusions) do
    middle = Earth.surface(centre)

    Enum.all?(inclusions, fn zone ->
      # `:far` is more than any number.
      not Zone.over?(zone, middle) and Zone.distance(zone, middle) > @max_way
    end)
  end

  @doc "The fence of a file, or all that is wrong with it, each line with the file's name."
  @spec read(Path.t()) :: {:ok, t()} | {:error, [String.t(), ...]}
  def read(path) do
    with {:ok, text} <- content(path),
         {:error, errors} <- parse(text) do
      {:error, Enum.map(errors, &"#{path}: #{&1}")}
    end
  end

  # No more than that is read of a file that somebody named by mistake.
  defp content(path) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.read(file, GeoJson.max_bytes() + 1)
      _ = :file.close(file)

      case result do
        {:ok, text} -> {:ok, text}
        :eof -> {:ok, ""}
        {:error, reason} -> {:error, ["#{path}: #{:file.format_error(reason)}"]}
      end
    else
      {:error, reason} -> {:error, ["#{path}: #{:file.format_error(reason)}"]}
    end
  end

  @doc "Each zone in a line, with its middle, so that a person sees whether latitude and longitude are swapped."
  @spec lines(t()) :: [String.t()]
  def lines(fence) do
    for %{polygons: [%{centre: centre} | _]} = zone <- fence.zones do
      {lat, lon} = centre |> Earth.surface() |> Earth.degrees()

      "#{zone.kind} zone \"#{zone.name}\" around #{at(%{lat: lat, lon: lon})} (latitude, longitude)" <>
        heights(zone)
    end
  end

  defp heights(%{floor: nil, ceiling: nil}), do: ""
  defp heights(zone), do: ", #{limits(zone)} #{above(zone)}"

  @doc "Whether a position is allowed. `what` is what the sentence calls it: `the target`."
  @spec check_position(t(), position(), String.t()) :: :ok | Refusal.denial()
  def check_position(fence, position, what) do
    place = place(position)

    case fence.zones |> violations(place) |> Enum.sort() |> List.first() do
      nil -> :ok
      {:exclusion, n} -> inside(Enum.at(fence.zones, n), position, place, what)
      :outside -> outside(inclusions(fence.zones), position, place, what)
    end
  end

  @doc "Whether the straight way (a great circle, with a steady climb) from one position to another is allowed."
  @spec check_way(t(), position(), position(), String.t()) :: :ok | Refusal.denial()
  def check_way(fence, from, to, what) do
    {start, stop} = {place(from), place(to)}
    length = Earth.distance(start.point, stop.point)

    if length > @max_way do
      Refusal.deny(:way_long, place: what, length: km(length), most: km(@max_way))
    else
      shares = Enum.flat_map(fence.zones, &Zone.crossings(&1, start, stop))

      [0.0, 1.0 | shares]
      |> Enum.sort()
      |> Enum.dedup()
      |> forbidden(fence.zones, start, stop)
      |> way(fence.zones, slant(length, from, to), what)
    end
  end

  @doc """
  Whether there is room for so many metres around a position, or around the way to it if `from` is given. `room`
  says why the vehicle needs it.
  """
  @spec check_room(t(), position() | nil, position(), room(), String.t()) ::
          :ok | Refusal.denial()
  def check_room(_fence, _from, _to, %{metres: metres}, _what) when metres == 0, do: :ok

  def check_room(fence, from, to, room, what) do
    {start, stop} = {place(from || to), place(to)}
    {inclusions, exclusions} = Enum.split_with(fence.zones, &(&1.kind == :inclusion))
    around = for zone <- inclusions, Zone.covers?(zone, stop), do: {Zone.clearance(zone, start, stop), zone}
    near = for zone <- exclusions, level?(zone, start, stop), do: {Zone.clearance(zone, start, stop), zone}
    # One zone that has room for all of it is enough.
    widest = if around == [], do: [], else: [Enum.max_by(around, &elem(&1, 0))]

    case Enum.find(widest ++ near, fn {metres, _zone} -> metres < room.metres end) do
      nil -> :ok
      {metres, zone} -> cramped(metres, zone, to, room, what)
    end
  end

  defp level?(zone, start, stop),
    do: Zone.band?(zone, start) or Zone.band?(zone, stop) or start.home != stop.home or start.msl != stop.msl

  defp cramped(metres, %{kind: kind, name: zone}, to, room, what) do
    place = "#{what} #{at(to)}"
    needed = metres(room.metres)

    Refusal.deny(:room,
      place: place,
      metres: needed,
      why: room.why,
      kind: kind,
      zone: zone,
      away: metres(metres)
    )
  end

  @doc "Whether a zone of it has a floor or a ceiling."
  @spec heights?(t()) :: boolean()
  def heights?(fence), do: Enum.any?(fence.zones, &(&1.floor != nil or &1.ceiling != nil))

  # Its length with the climb, as far as that is known.
  defp slant(length, from, to) do
    climb = if from.home && to.home, do: to.home - from.home, else: (to.msl || 0) - (from.msl || to.msl || 0)
    :math.sqrt(length * length + climb * climb)
  end

  defp place(position) do
    %{point: Earth.point(position.lat, position.lon), home: position.home, msl: position.msl}
  end

  # Between two crossings nothing changes, so the middle tells. Where it was forbidden from the start on it still may be.
  defp forbidden(shares, zones, start, stop) do
    shares
    |> Enum.zip(tl(shares))
    |> Enum.reduce_while(:start, fn {from, to}, excused ->
      found = violations(zones, along(start, stop, (from + to) / 2))
      excused = if excused == :start, do: found, else: Enum.filter(excused, &(&1 in found))

      case Enum.sort(found -- excused) do
        [] -> {:cont, excused}
        [first | _] -> {:halt, {first, from}}
      end
    end)
  end

  defp way({:outside, share}, zones, length, what) do
    zones = named(inclusions(zones))

    Refusal.deny(:way_leaves,
      place: what,
      length: metres(length),
      zones: zones,
      after: metres(share * length)
    )
  end

  defp way({{:exclusion, n}, share}, zones, length, what) do
    %{name: zone} = Enum.at(zones, n)
    Refusal.deny(:way_enters, place: what, length: metres(length), zone: zone, after: metres(share * length))
  end

  defp way(_excused, _zones, _length, _what), do: :ok

  defp along(start, stop, share) do
    %{
      point: Earth.between(start.point, stop.point, share),
      home: height(start.home, stop.home, share),
      msl: height(start.msl, stop.msl, share)
    }
  end

  defp height(from, to, share) when is_number(from) and is_number(to), do: from + (to - from) * share
  defp height(_from, _to, _share), do: nil

  # The violation at a place: `:outside` all inclusion zones, or in an exclusion zone, by its number.
  defp violations(zones, place) do
    inclusions = inclusions(zones)

    outside =
      if inclusions != [] and not Enum.any?(inclusions, &Zone.covers?(&1, place)), do: [:outside], else: []

    outside ++
      for {%{kind: :exclusion} = zone, n} <- Enum.with_index(zones),
          Zone.covers?(zone, place),
          do: {:exclusion, n}
  end

  defp inclusions(zones), do: Enum.filter(zones, &(&1.kind == :inclusion))

  defp inside(zone, position, place, what) do
    what = "#{what} #{at(position)}"
    deep = far(zone, place)
    Refusal.deny(:place_inside, place: what, zone: zone.name, metres: deep, band: band(zone, place))
  end

  defp outside(inclusions, position, place, what) do
    what = "#{what} #{at(position)}"

    case Enum.filter(inclusions, &Zone.over?(&1, place.point)) do
      [] ->
        nearest = Enum.min_by(inclusions, &Zone.distance(&1, place.point))
        Refusal.deny(:place_outside, place: what, metres: far(nearest, place), zone: named([nearest]))

      [zone | _] ->
        Refusal.deny(:place_height, place: what, zone: named([zone]), band: band(zone, place))
    end
  end

  # Atoms are greater than numbers: a distance that is not known is the greatest.
  defp far(zone, place) do
    case Zone.distance(zone, place.point) do
      :far -> "thousands of kilometres"
      metres -> metres(metres)
    end
  end

  defp band(%{floor: nil, ceiling: nil}, _place), do: ""

  defp band(zone, place) do
    case Map.fetch!(place, zone.reference) do
      nil -> " (#{limits(zone)} #{above(zone)}; its height #{above(zone)} is not known)"
      height -> " (#{limits(zone)} #{above(zone)}; it is at #{number(height)} m)"
    end
  end

  defp above(%{reference: :home}), do: "above home"
  defp above(_msl), do: "above mean sea level"

  defp limits(%{floor: nil, ceiling: ceiling}), do: "up to #{number(ceiling)} m"
  defp limits(%{floor: floor, ceiling: nil}), do: "from #{number(floor)} m"
  defp limits(%{floor: floor, ceiling: ceiling}), do: "from #{number(floor)} to #{number(ceiling)} m"

  defp named([zone]), do: "the zone \"#{zone.name}\""
  defp named(zones), do: "all #{length(zones)} inclusion zones"

  defp at(%{lat: lat, lon: lon}), do: "#{degrees(lat)}, #{degrees(lon)}"

  defp degrees(value), do: :erlang.float_to_binary(value / 1, decimals: 6)
  defp metres(value) when value >= 10_000, do: km(value)
  defp metres(value) when value < 10, do: "#{:erlang.float_to_binary(value / 1, decimals: 1)} m"
  defp metres(value), do: "#{round(value)} m"
  defp km(value), do: "#{:erlang.float_to_binary(value / 1000, decimals: 1)} km"
  defp number(value) when is_integer(value), do: "#{value}"

  defp number(value),
    do: value |> Float.round(1) |> Aerie.Base.Json.encode!() |> String.replace_suffix(".0", "")
end
