defmodule Aerie.Fleet.Missions.Course do
  @moduledoc """
  Where a vehicle is at which time of its plan, as far as the plan says: straight ways at planned speeds, without wind.
  Pure. What has no time or place in a plan ends the course or stands in `:notes`, and is not guessed.

  Places are metres to the east, to the north and above the sea on a flat map around an origin, which holds for the
  50 km that a plan may lead away from it.
  """

  alias MavCodec.Enums.MavCmd
  alias Protocols.Mission.{Item, Plan}

  @metres_per_degree 111_319.5
  @most_m 50_000
  # With its repetitions; a mission has fewer items.
  @most_points 2_000
  # Rounds through jumps that go nowhere.
  @most_steps 20_000

  command = fn name -> MavCmd.value(:"MAV_CMD_#{name}") end
  @waypoint command.("NAV_WAYPOINT")
  @spline command.("NAV_SPLINE_WAYPOINT")
  @takeoffs Enum.map(["NAV_TAKEOFF", "NAV_VTOL_TAKEOFF"], command)
  @lands Enum.map(["NAV_LAND", "NAV_VTOL_LAND"], command)
  @stay command.("NAV_LOITER_UNLIM")
  @for_a_time command.("NAV_LOITER_TIME")
  @delay command.("NAV_DELAY")
  @home command.("NAV_RETURN_TO_LAUNCH")
  @speed command.("DO_CHANGE_SPEED")
  @jump command.("DO_JUMP")
  # Below it are the commands by which a vehicle flies, one after the other.
  @last command.("NAV_LAST")

  @enforce_keys [:id, :points, :until]
  defstruct [:id, :points, :until, metres: 0.0, heights?: true, notes: []]

  @typedoc "Seconds after the start of the vehicle's mission, and metres."
  @type point :: {float(), float(), float(), float()}

  @typedoc """
    * `:points` - in the order of time; between two of them it flies straight and evenly
    * `:until` - how long it is where the course says: `:stays` at the last point, or is not known to be anywhere after
      `:ends`, because it has landed or the plan does not say
    * `:heights?` - false: its heights are not known above the sea, so only the map counts
  """
  @type t :: %__MODULE__{
          id: String.t(),
          points: [point()],
          until: :stays | :ends,
          metres: float(),
          heights?: boolean(),
          notes: [String.t()]
        }

  @typedoc """
    * `:place` - where it is now (degrees), nil if that is not known; `:up` - metres above home now, nil on the ground
    * `:home_m` - its home's height above the sea, nil if that is not known
    * `:speed`, `:climb`, `:descent` - m/s; `:circles?` - it cannot stop
  """
  @type vehicle :: %{
          id: String.t(),
          place: {number(), number()} | nil,
          up: number() | nil,
          home_m: number() | nil,
          speed: number(),
          climb: number(),
          descent: number(),
          circles?: boolean()
        }

  @doc "The course of a plan for a vehicle, on the map around `origin` (degrees)."
  @spec of(Plan.t(), vehicle(), origin :: {number(), number()}) :: t()
  def of(%Plan{items: items}, vehicle, origin) do
    # Where one that takes off before its mission begins it is not known.
    first = Enum.find(items, &(&1.command < @last))
    known? = vehicle.up != nil or match?(%{command: command} when command in @takeoffs, first)
    start = if known? and vehicle.place, do: flat(vehicle.place, origin)
    ground = vehicle.home_m || 0.0

    walk = %{
      vehicle: vehicle,
      origin: origin,
      at: start && Tuple.insert_at(start, 2, ground + (vehicle.up || 0)),
      t: 0.0,
      speed: vehicle.speed / 1,
      points: [],
      count: 0,
      metres: 0.0,
      heights?: start == nil or vehicle.home_m != nil,
      notes: if(start, do: [], else: ["its way to the first place is not compared"]),
      jumps: %{},
      until: nil
    }

    walk = walk |> point() |> fly(List.to_tuple(items), 0, @most_steps)

    %__MODULE__{
      id: vehicle.id,
      points: Enum.reverse(walk.points),
      until: walk.until || :stays,
      metres: walk.metres,
      heights?: walk.heights?,
      notes: walk.notes |> Enum.reverse() |> Enum.uniq()
    }
  end

  @doc "Seconds from the start to the end of the course."
  @spec seconds(t()) :: float()
  def seconds(%{points: []}), do: 0.0
  def seconds(%{points: points}), do: points |> List.last() |> elem(0)

  @doc "The place of a point of the map around `origin`, in degrees."
  @spec degrees({number(), number()}, origin :: {number(), number()}) :: {float(), float()}
  def degrees({x, y}, {lat0, lon0}) do
    lon = lon0 + x / (@metres_per_degree * :math.cos(lat0 * :math.pi() / 180))
    {lat0 + y / @metres_per_degree, :math.fmod(lon + 540.0, 360.0) - 180.0}
  end

  defp flat({lat, lon}, {lat0, lon0}) do
    # The shorter way around the earth.
    east = :math.fmod(lon - lon0 + 540.0, 360.0) - 180.0
    {east * @metres_per_degree * :math.cos(lat0 * :math.pi() / 180), (lat - lat0) * @metres_per_degree}
  end

  defp fly(%{until: nil} = walk, items, n, left) when n < tuple_size(items) do
    cond do
      left == 0 or walk.count >= @most_points ->
        ends(walk, n, "comes after more ways than are followed")

      true ->
        {walk, next} = item(walk, elem(items, n), n)
        fly(walk, items, next, left - 1)
    end
  end

  defp fly(walk, _items, _n, _left), do: walk

  defp item(walk, %{command: @jump, params: {to, times, _, _}}, n) do
    done = Map.get(walk.jumps, n, 0)

    cond do
      not (is_number(to) and to >= 1) -> {ends(walk, n, "jumps nowhere"), n + 1}
      is_number(times) and times >= 0 and done >= times -> {walk, n + 1}
      true -> {%{walk | jumps: Map.put(walk.jumps, n, done + 1)}, trunc(to) - 1}
    end
  end

  defp item(walk, %{command: @speed, params: {kind, speed, _, _}}, n) do
    if kind in [+0.0, 1.0, 0, 1, nil] and is_number(speed) and speed > 0,
      do: {%{walk | speed: speed / 1}, n + 1},
      else: {walk, n + 1}
  end

  defp item(walk, %{command: command}, n) when command == @home,
    do: {ends(walk, n, "flies home by the vehicle's own settings"), n + 1}

  defp item(walk, %{command: @delay, params: {seconds, _, _, _}}, n) do
    if is_number(seconds) and seconds >= 0,
      do: {wait(walk, seconds), n + 1},
      else: {ends(walk, n, "waits for a time of day"), n + 1}
  end

  defp item(walk, %{command: command} = item, n) when command in @takeoffs,
    do: {climb(walk, item, n), n + 1}

  defp item(walk, %{command: command} = item, n) when command in @lands do
    walk = to(walk, item, n)
    %{at: at} = walk
    down = if at && walk.vehicle.home_m, do: max(elem(at, 2) - walk.vehicle.home_m, 0), else: 0
    walk = if at && down > 0, do: leg(walk, put_elem(at, 2, elem(at, 2) - down)), else: walk
    {%{walk | until: :ends}, n + 1}
  end

  defp item(walk, %{command: @waypoint} = item, n), do: {walk |> to(item, n) |> hold(item), n + 1}

  defp item(walk, %{command: @spline} = item, n),
    do:
      {walk |> to(item, n) |> hold(item) |> note(n, "is flown in a curve, and compared as a straight way"),
       n + 1}

  defp item(walk, %{command: @for_a_time} = item, n),
    do: {walk |> to(item, n) |> hold(item) |> circles(n), n + 1}

  defp item(walk, %{command: @stay} = item, n),
    do:
      {%{(walk |> to(item, n) |> circles(n)) | until: :stays} |> note(n, "stays until somebody commands it"),
       n + 1}

  defp item(walk, %{command: command} = item, n) when command < @last,
    do: {walk |> to(item, n) |> ends(n, "(#{label(command)}) takes a time that the plan does not say"), n + 1}

  defp item(walk, _does_not_fly, n), do: {walk, n + 1}

  defp circles(%{vehicle: %{circles?: true}} = walk, n),
    do: note(walk, n, "is flown in a circle, and compared as a stop")

  defp circles(walk, _n), do: walk

  defp label(command), do: MavCmd.label(command) || "command #{command}"

  # Straight up where it is: firmwares of copters heed only the height.
  defp climb(walk, item, n) do
    %{at: at} = walk = if walk.at, do: walk, else: to(walk, item, n)
    {walk, up} = height(walk, item, n)
    if at && up && up > elem(at, 2), do: leg(walk, put_elem(at, 2, up)), else: walk
  end

  defp to(walk, item, n) do
    {walk, up} = height(walk, item, n)

    cond do
      not Item.flown?(item) or Item.local?(item.frame) ->
        walk

      walk.at == nil ->
        {x, y} = flat({item.x / 1.0e7, item.y / 1.0e7}, walk.origin)
        point(%{walk | at: {x, y, up || 0.0}})

      true ->
        {x, y} = flat({item.x / 1.0e7, item.y / 1.0e7}, walk.origin)

        if abs(x) > @most_m or abs(y) > @most_m,
          do: ends(walk, n, "lies more than #{div(@most_m, 1000)} km away"),
          else: leg(walk, {x, y, up || elem(walk.at, 2)})
    end
  end

  defp height(walk, %{z: nil}, _n), do: {walk, nil}

  defp height(%{vehicle: %{home_m: home}} = walk, item, n) do
    case Item.plain_frame(item.frame) do
      0 -> {walk, item.z}
      10 -> {note(%{walk | heights?: false}, n, "has a height above the ground, which is not known"), nil}
      _above_home when home != nil -> {walk, home + item.z}
      _above_home -> {%{walk | heights?: false}, item.z}
    end
  end

  defp leg(%{at: at} = walk, at), do: walk

  defp leg(%{at: {x, y, z}} = walk, {to_x, to_y, to_z} = to) do
    flat = :math.sqrt((to_x - x) * (to_x - x) + (to_y - y) * (to_y - y))
    rise = to_z - z
    up = if rise > 0, do: rise / walk.vehicle.climb, else: -rise / walk.vehicle.descent
    point(%{walk | at: to, t: walk.t + max(flat / walk.speed, up), metres: walk.metres + flat})
  end

  # Nil is not a time.
  defp hold(walk, %{params: {seconds, _, _, _}}) when is_number(seconds) and seconds > 0,
    do: wait(walk, seconds)

  defp hold(walk, _item), do: walk

  defp wait(%{at: nil} = walk, _seconds), do: walk
  defp wait(walk, seconds), do: point(%{walk | t: walk.t + seconds})

  defp point(%{at: nil} = walk), do: walk

  defp point(%{at: {x, y, z}} = walk),
    do: %{walk | points: [{walk.t, x / 1, y / 1, z / 1} | walk.points], count: walk.count + 1}

  defp ends(walk, n, why), do: note(%{walk | until: :ends}, n, why <> ": not compared from there on")
  defp note(walk, n, text), do: %{walk | notes: ["item #{n + 1} #{text}" | walk.notes]}
end
