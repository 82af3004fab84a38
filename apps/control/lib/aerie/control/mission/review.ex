defmodule Aerie.Control.Mission.Review do
  @moduledoc """
  Asks the policy about a plan before its first item is sent: about each item, each straight leg from one position to the next,
  circles, jumps, and the way home.

  The review assumes straight flight between positions. It does not judge the bulge of a spline, or the turn that a plane flies around a
  waypoint. How the vehicle gets to the first position is not known before it starts.
  """

  alias Aerie.Mission.Item
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Context, FlightPath, Intent, Mavlink}
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages.MissionCount

  @rtl MavCmd.value(:MAV_CMD_NAV_RETURN_TO_LAUNCH)
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @type refusal :: {:deny, Policy.rule(), seq :: non_neg_integer() | nil, reason :: String.t()}

  @doc """
  The first refusal, with the number of the item as the vehicle counts, or nil if the plan as a whole is refused.
  `items` are those of the wire (`Aerie.Mission.Onboard.items/3`).
  """
  @spec plan(Policy.t(), [Item.t()], 0..2, Mavlink.vehicle(), Context.t()) :: :allow | refusal()
  def plan(policy, items, type, vehicle, context) do
    # A minimum altitude does not forbid landing.
    policy = %{policy | min_altitude: nil}
    whole = Mavlink.facts(%MissionCount{mission_type: type, count: length(items)}, vehicle)

    with :allow <- decide(policy, whole, context, nil),
         :allow <- each(policy, items, type, vehicle, context) do
      if type == 0, do: ways(policy, items, vehicle, context), else: :allow
    end
  end

  @doc "The place, in degrees, to which a vehicle flies for an item of a plan (not its home); nil if there is none."
  @spec place(Item.t(), Mavlink.vehicle()) :: {number(), number()} | nil
  def place(item, vehicle) do
    case flown(item, 1, vehicle) do
      {%{lat: lat, lon: lon}, _radius} when lat != nil -> {lat, lon}
      _nowhere -> nil
    end
  end

  # Each item by itself, as if a ground station had sent it.
  defp each(policy, items, type, vehicle, context) do
    first(Enum.with_index(items), fn {item, seq} ->
      facts = asked(item, seq, type, vehicle)

      # An item without a position is where the previous one is; circles are judged with the ways.
      case facts.path do
        {_kind, [%{lat: nil}]} -> decide(policy, %{facts | path: :none}, context, seq)
        {:all, [{_kind, [%{lat: nil}]}, _circle]} -> decide(policy, %{facts | path: :none}, context, seq)
        {:all, [place, _circle]} -> decide(policy, %{facts | path: place}, context, seq)
        _path -> decide(policy, facts, context, seq)
      end
    end)
  end

  defp asked(item, seq, type, vehicle),
    do: item |> placeless() |> Item.message(seq, type, {0, 0}) |> Mavlink.facts(vehicle)

  # A mission's legs: from each position to the next one.
  defp ways(policy, items, vehicle, context) do
    indexed = Enum.with_index(items)

    places =
      for {item, seq} <- indexed,
          {%{lat: lat} = place, _radius} when lat != nil <- [flown(item, seq, vehicle)],
          do: {place, seq}

    home = context.home && Map.put(context.home, :alt_rel, 0.0)

    indexed
    |> Enum.reduce_while(home, fn {item, seq}, from ->
      case step(policy, item, seq, from, {places, vehicle, context}) do
        {:deny, _rule, _seq, _reason} = refusal -> {:halt, refusal}
        to -> {:cont, to}
      end
    end)
    |> then(&if match?({:deny, _, _, _}, &1), do: &1, else: :allow)
  end

  # Where the vehicle is after an item, or the refusal of it.
  defp step(policy, %{command: @jump, params: {target, _, _, _}}, seq, from, {places, _, context})
       when is_number(target) do
    case Enum.find(places, fn {_place, n} -> n >= target end) do
      nil -> from
      {place, _n} -> with :allow <- way(policy, place, "mission item #{seq}", seq, from, context), do: from
    end
  end

  defp step(policy, %{command: @rtl}, seq, from, {_places, _vehicle, %{home: home} = context})
       when home != nil do
    place = %{lat: home.lat, lon: home.lon, height: :same}
    with :allow <- way(policy, place, "home (mission item #{seq})", seq, from, context), do: from
  end

  defp step(policy, item, seq, from, {_places, vehicle, context}) do
    case flown(item, seq, vehicle) do
      nil ->
        from

      {place, radius} ->
        place = here(place, from)
        what = "mission item #{seq}"

        with :allow <- way(policy, place, what, seq, from, context),
             to = reached(place, from, context),
             :allow <- circle(policy, radius, place, what, seq, to, context),
             do: to
    end
  end

  # The place or the height to which the vehicle flies, with the radius of its circle there; nil if it does not.
  defp flown(item, seq, vehicle) do
    case not Item.local?(item.frame) and asked(item, seq, 0, vehicle).path do
      {:at, [place]} -> {place, nil}
      {:all, [{:at, [place]}, {:ring, _place, metres}]} -> {place, metres}
      _not_flown -> nil
    end
  end

  # Both firmwares take 0, 0 for the present position.
  defp placeless(%{x: 0, y: 0} = item), do: %{item | x: nil, y: nil}
  defp placeless(item), do: item

  defp here(%{lat: nil} = place, %{lat: lat, lon: lon}), do: %{place | lat: lat, lon: lon}
  defp here(place, _from), do: place

  defp way(_policy, %{lat: nil, height: :same}, _what, _seq, _from, _context), do: :allow

  defp way(policy, %{lat: nil, height: height}, what, seq, _from, context),
    do: decide(policy, facts({:level, height}, what), context, seq)

  defp way(policy, place, what, seq, nil, context),
    do: decide(policy, facts({:at, [place]}, what), context, seq)

  defp way(policy, place, what, seq, from, context),
    do: decide(policy, facts({:to, [place]}, what), at(context, from), seq)

  defp circle(_policy, radius, _place, _what, _seq, to, _context) when radius == nil or to == nil, do: :allow

  defp circle(policy, metres, place, what, seq, to, context),
    do: decide(policy, facts({:around, place, metres}, "the circle of " <> what), at(context, to), seq)

  defp reached(%{lat: nil}, from, _context), do: from

  defp reached(place, from, context) do
    {:ok, [{nil, position, _given}]} = FlightPath.legs(facts({:at, [place]}, ""), at(context, from))
    %{lat: position.lat, lon: position.lon, alt_rel: position.home, alt_msl: position.msl}
  end

  defp at(context, nil), do: %{context | position: nil}

  defp at(context, place),
    do: %{context | position: Map.merge(%{alt_rel: nil, alt_msl: nil, heading: nil, at: nil}, place)}

  defp facts(path, what), do: %Intent{type: "mission_upload", permission: :mission, path: path, what: what}

  defp decide(policy, facts, context, seq) do
    case Policy.decide(policy, facts, context) do
      :allow -> :allow
      {:deny, rule, reason} -> {:deny, rule, seq, reason}
    end
  end

  defp first(values, fun) do
    Enum.find_value(values, :allow, fn value ->
      case fun.(value) do
        :allow -> nil
        refusal -> refusal
      end
    end)
  end
end
