defmodule Aerie.Control.Mission.OwnFence do
  @moduledoc """
  Checks a plan against the fence in it, and that fence against the place of the vehicle that it is for. Pure.

  ArduPilot wants a vehicle inside every stay-inside zone unless FENCE_OPTIONS has the bit for their union
  (`AC_PolyFence_loader::breached`); for PX4 one of them is enough (`Geofence::checkPolygons`). Straight ways are judged as well (`Ways`): between the items, by
  jumps, from home and back; home is the vehicle's, or while that is not known the plan's.
  """

  alias Aerie.Control.Policy.Mavlink.Review
  alias Protocols.Mission.Plan
  alias Aerie.Control.Mission.OwnFence.{Area, Ways}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware

  # Corners times places that are judged: some tenths of a second.
  @most_work 1_000_000
  @shown 20

  @typedoc """
  The vehicle that the plan is for: firmware and kind, and where it and its home are just now, in degrees, nil if that is not known. `flying?`: it is known to be in
  the air; `fenced?`: its fence is known to be on.
  """
  @type vehicle :: %{
          autopilot: Firmware.name(),
          vehicle_type: String.t(),
          place: Ways.place() | nil,
          home: Ways.place() | nil,
          flying?: boolean(),
          fenced?: boolean()
        }

  @typedoc """
  `index` in the list of the part, nil for the part as a whole. `breach?`: with this fence the vehicle, which flies, breaches it at once.
  `outside?`: the plan itself makes the vehicle leave the fence.
  """
  @type finding :: %{
          part: :mission | :fence | :rally,
          index: non_neg_integer() | nil,
          text: String.t(),
          breach?: boolean(),
          outside?: boolean()
        }

  @doc "The vehicle of a snapshot at a time (unix microseconds); nil: nothing is known of it."
  @spec vehicle(map() | nil, now :: integer()) :: vehicle()
  def vehicle(nil, _now),
    do: %{autopilot: :generic, vehicle_type: "unknown", place: nil, home: nil, flying?: false, fenced?: false}

  def vehicle(snapshot, now) do
    context = Context.new(snapshot.groups, nil, now)
    place = with {:ok, %{lat: lat, lon: lon}} <- Context.position(context), do: {lat, lon}

    %{
      autopilot: snapshot.autopilot,
      vehicle_type: snapshot.vehicle_type,
      place: if(match?({lat, lon} when is_number(lat) and is_number(lon), place), do: place),
      home: with(%{lat: lat, lon: lon} <- context.home, do: {lat, lon}),
      flying?: context.in_air == true,
      fenced?: match?(%{health: %{data: %{fence_enabled: true}}}, snapshot.groups)
    }
  end

  @doc "Whether a fence may be sent: not one that the vehicle would breach at once."
  @spec breach([finding()]) :: :allow | Refusal.denial()
  def breach(findings) do
    case Enum.find(findings, & &1.breach?) do
      nil -> :allow
      %{text: text} -> Refusal.deny(:breach, how: text)
    end
  end

  @doc """
  What concerns sending a kind of the plan, as sentences, the first twenty: everything about a fence, of a mission or rally points only they.
  """
  @spec remarks([finding()], :mission | :fence | :rally) :: [String.t()]
  def remarks(findings, kind) do
    texts = for %{part: part, text: text} <- findings, kind in [:fence, part], do: text

    case Enum.split(texts, @shown) do
      {texts, []} -> texts
      {texts, more} -> texts ++ ["and #{length(more)} more"]
    end
  end

  @doc "All that is wrong."
  @spec check(Plan.t(), vehicle()) :: [finding()]
  def check(%Plan{fence: []}, _vehicle), do: []

  def check(plan, vehicle) do
    areas = Area.all(plan.fence)
    places = places(plan, vehicle)
    ways = Ways.all(plan.items, vehicle, vehicle.home || home(plan))
    corners = plan.fence |> Enum.map(&corners/1) |> Enum.sum()

    if corners * (length(places) + length(ways) + corners) > @most_work,
      do:
        [finding(:fence, nil, "the plan is too large to be checked against its own fence")] ++
          here(areas, vehicle),
      else:
        here(areas, vehicle) ++
          apart(areas, vehicle) ++ outside(places, areas, vehicle) ++ ways(ways, areas, vehicle)
  end

  defp home(%{home: {position, _altitude}}), do: degrees(position)
  defp home(_unknown), do: nil

  defp corners({_kind, {:polygon, corners}}), do: length(corners)
  defp corners(_circle), do: 1

  # The places that the plan makes the vehicle fly to, and their names.
  defp places(plan, vehicle) do
    items =
      for {item, n} <- Enum.with_index(plan.items),
          place = Review.place(item, Map.take(vehicle, [:autopilot, :vehicle_type])),
          do: {:mission, n, "item #{n + 1}", place}

    rally =
      for {{position, _height}, n} <- Enum.with_index(plan.rally),
          do: {:rally, n, "rally point #{n + 1}", degrees(position)}

    back =
      for {position, _height} <- List.wrap(plan.fence_return),
          do: {:fence, nil, "the return point", degrees(position)}

    items ++ rally ++ back
  end

  defp degrees({lat, lon}), do: {lat / 1.0e7, lon / 1.0e7}

  defp outside(places, areas, vehicle) do
    for {part, index, name, place} <- places,
        how = wrong(place, areas, vehicle),
        do: %{finding(part, index, "#{name} is #{elem(how, 1)}") | outside?: true}
  end

  # Ways whose items are right, at least one place between each two crossings of a border.
  defp ways(ways, areas, vehicle) do
    for %{from: from, to: to, index: index, name: name, items: items} <- ways,
        Enum.all?(items, &(wrong(&1, areas, vehicle) == nil)),
        how = areas |> between(from, to) |> Enum.find_value(&wrong(&1, areas, vehicle)),
        do: %{finding(:mission, index, "#{name} goes #{way(elem(how, 1))}") | outside?: true}
  end

  defp between(areas, {lat1, lon1} = from, {lat2, lon2} = to) do
    shares = areas |> Enum.flat_map(&Area.crossings(&1, from, to)) |> Enum.sort()

    for {one, two} <- Enum.zip([0.0 | shares], shares ++ [1.0]),
        at = (one + two) / 2,
        do: {lat1 + at * (lat2 - lat1), lon1 + at * (lon2 - lon1)}
  end

  defp way("in " <> zone), do: "through " <> zone
  defp way(outside), do: outside

  defp here(_areas, %{place: nil}), do: []

  defp here(areas, vehicle) do
    case wrong(vehicle.place, areas, vehicle) do
      nil ->
        []

      {certain?, how} ->
        breach? = certain? and vehicle.flying? and vehicle.fenced?

        now =
          if breach?, do: "with this fence it is in breach at once", else: "with the fence on it is in breach"

        [%{finding(:fence, nil, "the vehicle is #{how}: #{now}") | breach?: breach?}]
    end
  end

  # The violation at a place, and whether it holds for every setting of the vehicle's options.
  defp wrong(place, areas, vehicle) do
    {inclusions, exclusions} = Enum.split_with(areas, &(&1.kind == :inclusion))
    without = Enum.reject(inclusions, &Area.inside?(&1, place))

    case Enum.find(exclusions, &Area.inside?(&1, place)) do
      %{number: n} -> {true, "in the plan's keep-out zone #{n}"}
      nil when without == [] -> nil
      nil when length(without) == length(inclusions) -> {true, "outside #{named(inclusions)}"}
      nil -> if union?(vehicle), do: nil, else: {false, "outside #{named(without)}"}
    end
  end

  defp named([%{number: n}]), do: "the plan's stay-inside zone #{n}"
  defp named(zones), do: "the plan's stay-inside zones #{Enum.map_join(zones, ", ", & &1.number)}"

  # No vehicle is inside of both.
  defp apart(areas, vehicle) do
    inclusions = Enum.filter(areas, &(&1.kind == :inclusion))

    if union?(vehicle) do
      []
    else
      for one <- inclusions, two <- inclusions, one.number < two.number, Area.apart?(one, two) do
        finding(
          :fence,
          nil,
          "stay-inside zones #{one.number} and #{two.number} have no place in common, and the vehicle has to be inside both" <>
            " (ArduPilot, unless its FENCE_OPTIONS allow either)"
        )
      end
      |> Enum.take(@shown)
    end
  end

  defp union?(vehicle), do: Firmware.traits(vehicle.autopilot).any_zone?

  defp finding(part, index, text),
    do: %{part: part, index: index, text: text, breach?: false, outside?: false}
end
