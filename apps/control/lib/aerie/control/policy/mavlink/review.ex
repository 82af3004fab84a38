defmodule Aerie.Control.Policy.Mavlink.Review do
  @moduledoc """
  Asks the policy about a plan before its first item is sent: about each item, each straight leg from one position
  to the next, in order and by each jump, and the way home.

  The review assumes straight flight between positions, with the room that a vehicle takes around them
  (`Aerie.Vehicle.Firmware.Room`). How the vehicle gets to the first position is not known before it
  starts.
  """

  alias Protocols.Mission.Item
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{FlightPath, Intent, Mavlink}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages.MissionCount

  @rtl MavCmd.value(:MAV_CMD_NAV_RETURN_TO_LAUNCH)
  @tag MavCmd.value(:MAV_CMD_JUMP_TAG)
  @jump_tag MavCmd.value(:MAV_CMD_DO_JUMP_TAG)
  @landing MavCmd.value(:MAV_CMD_DO_LAND_START)
  @max_legs 20_000
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @type refusal :: {:deny, Policy.rule(), seq :: non_neg_integer() | nil, reason :: String.t()}

  @doc """
  The first refusal, with the number of the item as the vehicle counts, or nil if the plan as a whole is refused.
  `items` are those of the wire (`Protocols.Mission.Onboard.items/3`).
  """
  @spec plan(Policy.t(), [Item.t()], 0..2, Mavlink.vehicle(), Context.t()) :: :allow | refusal()
  def plan(policy, items, type, vehicle, context) do
    # A minimum altitude does not forbid landing.
    policy = %{policy | min_altitude: nil}
    context = struct!(context, Map.take(vehicle, [:autopilot, :vehicle_type]))
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
      {%{lat: lat, lon: lon}, _sweep} when lat != nil -> {lat, lon}
      _nowhere -> nil
    end
  end

  # Each item by itself, as if a ground station had sent it.
  defp each(policy, items, type, vehicle, context) do
    first(Enum.with_index(items), fn {item, seq} ->
      facts = asked(item, seq, type, vehicle)

      # An item without a position is where the previous one is; the room around it is judged with its way.
      path = if match?({_kind, [%{lat: nil}]}, facts.path), do: :none, else: facts.path
      decide(policy, %{facts | path: path, sweep: nil}, context, seq)
    end)
  end

  defp asked(item, seq, type, vehicle),
    do: item |> Item.message(seq, type, {0, 0}) |> Mavlink.facts(vehicle)

  # A mission's legs: from each place where the vehicle may be to the place that comes next, by each jump as well.
  defp ways(policy, items, vehicle, context) do
    home = context.home && Map.put(context.home, :alt_rel, 0.0)
    fly([{0, home, 0}], %{}, flight(policy, items, vehicle, context))
  end

  defp flight(policy, items, vehicle, context) do
    numbered =
      for {item, seq} <- Enum.with_index(items), into: %{}, do: {seq, {item, flown(item, seq, vehicle)}}

    {policy, numbered, tags(numbered), context}
  end

  @doc "The ways from where the vehicle is just now to the entries of a mission, and on from there."
  @spec entered(Policy.t(), [Item.t()], [Intent.entry()], Mavlink.vehicle(), Context.t()) ::
          :allow | refusal()
  def entered(policy, items, entries, vehicle, context) do
    policy = %{policy | min_altitude: nil}
    context = struct!(context, Map.take(vehicle, [:autopilot, :vehicle_type]))
    flight = {_policy, numbered, tags, _context} = flight(policy, items, vehicle, context)

    here =
      case Context.position(context) do
        {:ok, position} -> position
        {:unknown, _why} -> nil
      end

    starts =
      Enum.flat_map(entries, fn
        {:item, seq} -> [seq]
        {:tag, tag} -> for {known, seq} <- tags, known == tag, do: seq
        :landing -> for {seq, {%{command: @landing}, _}} <- numbered, do: seq
      end)

    if here == nil and context.in_air != false and starts != [] do
      {:unknown, why} = Context.position(context)
      {:deny, :geofence, nil, Refusal.text(:way_to_mission_unknown, unknown: why)}
    else
      fly(for(seq <- starts, do: {seq, here, seq}), %{}, flight)
    end
  end

  @doc "The ways from an item of a mission on."
  @spec onward(Policy.t(), [Item.t()], seq :: non_neg_integer(), Mavlink.vehicle(), Context.t()) ::
          :allow | refusal()
  def onward(policy, items, seq, vehicle, context) do
    context = struct!(context, Map.take(vehicle, [:autopilot, :vehicle_type]))
    fly([{seq, nil, seq}], %{}, flight(%{policy | min_altitude: nil}, items, vehicle, context))
  end

  defp tags(items), do: for({seq, {%{command: @tag, params: {tag, _, _, _}}, _}} <- items, do: {tag, seq})

  # `to_do`: an item, where the vehicle is before it, and the number that its way is called by: its own, or that of
  # the jump to it.
  defp fly([], _done, _plan), do: :allow

  defp fly([{seq, from, _name} = next | to_do], done, {_policy, items, _tags, _context} = plan) do
    cond do
      not is_map_key(items, seq) or is_map_key(done, {seq, from}) ->
        fly(to_do, done, plan)

      map_size(done) >= @max_legs ->
        {:deny, :geofence, seq, Refusal.text(:ways_many)}

      true ->
        case step(next, items[seq], plan) do
          {:deny, _rule, _seq, _reason} = refusal -> refusal
          more -> fly(more ++ to_do, Map.put(done, {seq, from}, true), plan)
        end
    end
  end

  # What comes after an item, or the refusal of it.
  defp step({seq, from, _name}, {%{command: @jump, params: {target, _, _, _}}, _}, _plan)
       when is_number(target),
       do: [{trunc(target), from, seq}, {seq + 1, from, seq + 1}]

  defp step({seq, from, _name}, {%{command: @jump_tag, params: {tag, _, _, _}}, _}, {_, _, tags, _}),
    do: [{seq + 1, from, seq + 1} | for({^tag, target} <- tags, do: {target, from, seq})]

  defp step({seq, from, _name}, {%{command: @rtl}, _}, {policy, _items, _tags, %{home: home} = context})
       when home != nil do
    place = %{lat: home.lat, lon: home.lon, height: :same}

    with :allow <- way(policy, {place, nil}, "home (mission item #{seq})", seq, from, context),
         do: [{seq + 1, from, seq + 1}]
  end

  # It goes on from where it was, by the name of the jump that led here.
  defp step({seq, from, name}, {_item, nil}, _plan),
    do: [{seq + 1, from, if(name == seq, do: seq + 1, else: name)}]

  defp step({seq, from, name}, {_item, {place, sweep}}, {policy, _items, _tags, context}) do
    place = here(place, from)

    with :allow <- way(policy, {place, sweep}, "mission item #{name}", name, from, context),
         do: [{seq + 1, reached(place, from, context), seq + 1}]
  end

  # The place or the height to which the vehicle flies, and what happens there; nil if it does not.
  defp flown(item, seq, vehicle) do
    facts = asked(item, seq, 0, vehicle)

    case not Item.local?(item.frame) and facts.path do
      {:at, [place]} -> {place, facts.sweep}
      _not_flown -> nil
    end
  end

  defp here(%{lat: nil} = place, %{lat: lat, lon: lon}), do: %{place | lat: lat, lon: lon}
  defp here(place, _from), do: place

  defp way(_policy, {%{lat: nil, height: :same}, _sweep}, _what, _seq, _from, _context), do: :allow

  defp way(policy, {%{lat: nil, height: height}, _sweep}, what, seq, _from, context),
    do: decide(policy, facts({:level, height}, what), context, seq)

  defp way(policy, {place, sweep}, what, seq, nil, context),
    do: decide(policy, %{facts({:at, [place]}, what) | sweep: sweep}, context, seq)

  defp way(policy, {place, sweep}, what, seq, from, context),
    do: decide(policy, %{facts({:to, [place]}, what) | sweep: sweep}, at(context, from), seq)

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
    with {:deny, rule, reason} <- Policy.decide(policy, facts, context), do: {:deny, rule, seq, reason}
  end

  defp first(values, fun) do
    Enum.find_value(values, :allow, fn value -> with(:allow <- fun.(value), do: nil) end)
  end
end
