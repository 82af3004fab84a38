defmodule Aerie.Fleet.Missions.Variant do
  @moduledoc """
  One plan as several vehicles fly it, each a little beside the others, and which of several files is for whom. Pure.
  """

  alias Aerie.Base.Geo.Earth
  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias Protocols.Mission.{Item, Plan}

  @typedoc "Metres to the east, to the north and up from one vehicle to the next."
  @type offset :: %{east: number(), north: number(), up: number()}

  @msl [MavFrame.value(:MAV_FRAME_GLOBAL), MavFrame.value(:MAV_FRAME_GLOBAL_INT)]
  # What a camera looks at does not move with the vehicle.
  @looks Enum.map([:MAV_CMD_NAV_ROI, :MAV_CMD_DO_SET_ROI, :MAV_CMD_DO_SET_ROI_LOCATION], &MavCmd.value/1)
  # The ground stays where it is.
  @lands Enum.map([:MAV_CMD_NAV_LAND, :MAV_CMD_NAV_VTOL_LAND, :MAV_CMD_NAV_PAYLOAD_PLACE], &MavCmd.value/1)
  # Nearer to a pole, east differs from item to item.
  @most_degrees 85.0

  @doc """
  The plan of the vehicle before which `n` others go. All places that are flown to move; where a camera looks, what has
  no place, landings' heights, the fence and the rally points stay. The error names the item.
  """
  @spec offset(Plan.t(), non_neg_integer(), offset()) :: {:ok, Plan.t()} | {:error, String.t()}
  def offset(plan, n, %{east: east, north: north, up: up}) do
    by = {n * east, n * north, n * up}
    home = with {_place, metres} <- plan.home, do: metres

    items =
      plan.items
      |> Enum.with_index(1)
      |> Enum.reduce_while([], fn {item, number}, items ->
        case moved(item, by, home) do
          {:ok, item} -> {:cont, [item | items]}
          {:error, why} -> {:halt, {:error, "item #{number} #{why}"}}
        end
      end)

    with [_ | _] = items <- items,
         do: {:ok, %{plan | items: Enum.reverse(items)}},
         else: (
           [] -> {:ok, plan}
           error -> error
         )
  end

  defp moved(item, {east, north, up}, _home) when east == 0 and north == 0 and up == 0, do: {:ok, item}

  defp moved(%{x: x, y: y} = item, by, home) when is_integer(x) and is_integer(y) and {x, y} != {0, 0} do
    cond do
      not Item.place?(item.command, item.frame) or item.command in @looks ->
        {:ok, item}

      Item.local?(item.frame) ->
        {:error, "has a place in metres from the vehicle, which cannot be moved: use a plan with coordinates"}

      abs(x) > @most_degrees * 1.0e7 ->
        {:error,
         "lies beyond #{@most_degrees}° of latitude, where plans are not moved: give each its own file"}

      true ->
        raised(shifted(item, by), by, home)
    end
  end

  defp moved(item, _by, _home), do: {:ok, item}

  defp shifted(item, {east, north, _up}) when east == 0 and north == 0, do: item

  defp shifted(%{x: x, y: y} = item, {east, north, _up}) do
    here = Earth.point(x / 1.0e7, y / 1.0e7)
    bearing = :math.atan2(east, north) * 180 / :math.pi()
    metres = :math.sqrt(east * east + north * north)
    {lat, lon} = here |> Earth.destination(bearing, metres) |> Earth.degrees()
    %{item | x: round(lat * 1.0e7), y: round(lon * 1.0e7)}
  end

  defp raised(%{command: command} = item, _by, _home) when command in @lands, do: {:ok, item}
  defp raised(%{z: nil} = item, _by, _home), do: {:ok, item}

  defp raised(item, {_east, _north, up}, home) do
    z = item.z + up
    low = if item.frame in @msl, do: home || z, else: 0

    if up < 0 and z < low,
      do:
        {:error,
         "would be at #{round1(z)} m, below #{if item.frame in @msl, do: "home", else: "the ground"}: " <>
           "raise the plan, or give less down"},
      else: {:ok, %{item | z: z}}
  end

  defp round1(metres), do: Float.round(metres / 1, 1)

  @doc """
  Which file is for which vehicle: the one whose name has the vehicle's id in it as a word, or else one of its tags.
  Files that are for none of them are spare.
  """
  @spec assign([name :: String.t()], [{id :: String.t(), tags :: [String.t()]}]) ::
          {%{(id :: String.t()) => {:ok, name :: String.t()} | {:error, String.t()}}, spare :: [String.t()]}
  def assign(names, vehicles) do
    found = for {id, tags} <- vehicles, do: {id, matching(names, [[id], tags])}

    own =
      for {id, names} <- found, into: %{} do
        case names do
          [name] -> {id, {:ok, name}}
          [] -> {id, {:error, "no file's name has #{id} or a tag of it"}}
          names -> {id, {:error, "#{Enum.join(names, ", ")} are all for it: leave one"}}
        end
      end

    {own, names -- Enum.flat_map(found, &elem(&1, 1))}
  end

  # An id says more than a tag.
  defp matching(names, words) do
    Enum.find_value(words, [], fn words ->
      with [] <- Enum.filter(names, fn name -> Enum.any?(words, &word?(name, &1)) end), do: nil
    end)
  end

  # `sim-1` is not a word of `sim-10.plan`.
  defp word?(name, word) do
    name = name |> Path.rootname() |> String.downcase()
    word = String.downcase(word)

    Enum.any?(:binary.matches(name, word), fn {at, length} ->
      edge?(name, at - 1) and edge?(name, at + length)
    end)
  end

  defp edge?(name, at),
    do:
      at < 0 or at >= byte_size(name) or :binary.at(name, at) not in ~c"0123456789abcdefghijklmnopqrstuvwxyz"
end
