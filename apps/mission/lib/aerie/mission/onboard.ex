defmodule Aerie.Mission.Onboard do
  @moduledoc """
  A plan as a vehicle stores it: lists of items by mission type (0 mission, 1 fence, 2 rally points), as `Aerie.Mission.Transfer`
  sends and reads them, and back.
  """

  alias Aerie.Mission.{Item, Plan}
  alias MavCodec.Enums.{MavCmd, MavFrame}

  @waypoint MavCmd.value(:MAV_CMD_NAV_WAYPOINT)
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @rally MavCmd.value(:MAV_CMD_NAV_RALLY_POINT)
  @return MavCmd.value(:MAV_CMD_NAV_FENCE_RETURN_POINT)
  @corner %{
    inclusion: MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    exclusion: MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
  }
  @circle %{
    inclusion: MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION),
    exclusion: MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
  }
  @polygons Map.new(@corner, fn {kind, command} -> {command, kind} end)
  @circles Map.new(@circle, fn {kind, command} -> {command, kind} end)
  @global MavFrame.value(:MAV_FRAME_GLOBAL)
  @relative MavFrame.value(:MAV_FRAME_GLOBAL_RELATIVE_ALT)

  @doc "The items of a part of a plan, for a firmware."
  @spec items(Plan.t(), 0..2, module()) :: [Item.t()]
  def items(%Plan{items: []}, 0, _protocol), do: []

  def items(plan, 0, protocol) do
    items = Enum.map(plan.items, &jump(&1, protocol.item_offset()))
    if protocol.home_is_item_0?(), do: [home(plan) | items], else: items
  end

  def items(plan, 1, _protocol) do
    back =
      for {{x, y}, z} <- List.wrap(plan.fence_return),
          do: %Item{command: @return, frame: @relative, x: x, y: y, z: z}

    Enum.flat_map(plan.fence, &zone/1) ++ back
  end

  def items(plan, 2, _protocol),
    do: for({{x, y}, z} <- plan.rally, do: %Item{command: @rally, frame: @relative, x: x, y: y, z: z})

  @doc """
  A plan with one part replaced by the items of a vehicle; an error names the item that is not valid.
  """
  @spec put(Plan.t(), 0..2, [Item.t()], module()) :: {:ok, Plan.t()} | {:error, String.t()}
  def put(plan, 0, items, protocol) do
    {home, items} = if protocol.home_is_item_0?(), do: Enum.split(items, 1), else: {[], items}

    home =
      case home do
        [%Item{x: x, y: y, z: z}] when is_integer(x) and is_integer(y) and is_float(z) and {x, y} != {0, 0} ->
          {{x, y}, z}

        _none ->
          plan.home
      end

    {:ok, %{plan | home: home, items: Enum.map(items, &jump(&1, -protocol.item_offset()))}}
  end

  def put(plan, 1, items, _protocol), do: zones(items, 0, %{plan | fence: [], fence_return: nil})

  def put(plan, 2, items, _protocol) do
    case Enum.find_index(items, &(&1.command != @rally or &1.x == nil or &1.y == nil)) do
      nil -> {:ok, %{plan | rally: for(item <- items, do: {{item.x, item.y}, item.z || 0.0})}}
      seq -> {:error, "item #{seq} is not a rally point"}
    end
  end

  defp home(%{home: {{x, y}, z}}), do: %Item{command: @waypoint, frame: @global, x: x, y: y, z: z}
  # ArduPilot puts a value of its own there.
  defp home(_plan), do: %Item{command: @waypoint, frame: @global}

  defp jump(%{command: @jump, params: {target, repeat, p3, p4}} = item, offset) when is_number(target),
    do: %{item | params: {target + offset, repeat, p3, p4}}

  defp jump(item, _offset), do: item

  defp zone({kind, {:polygon, corners}}) do
    count = length(corners) / 1

    for {x, y} <- corners,
        do: %Item{command: @corner[kind], frame: @global, params: {count, 0.0, 0.0, 0.0}, x: x, y: y}
  end

  defp zone({kind, {:circle, {x, y}, radius}}),
    do: [%Item{command: @circle[kind], frame: @global, params: {radius, 0.0, 0.0, 0.0}, x: x, y: y}]

  defp zones([], _seq, plan), do: {:ok, %{plan | fence: Enum.reverse(plan.fence)}}

  defp zones([%{x: x, y: y} | _rest], seq, _plan) when x == nil or y == nil,
    do: {:error, "item #{seq} of the fence has no place"}

  defp zones([%{command: @return} = item | rest], seq, plan),
    do: zones(rest, seq + 1, %{plan | fence_return: {{item.x, item.y}, item.z || 0.0}})

  defp zones([%{command: command} = item | rest], seq, plan) when is_map_key(@circles, command) do
    zone = {@circles[command], {:circle, {item.x, item.y}, elem(item.params, 0) || 0.0}}
    zones(rest, seq + 1, %{plan | fence: [zone | plan.fence]})
  end

  defp zones([%{command: command} = item | _] = items, seq, plan) when is_map_key(@polygons, command) do
    count = trunc(elem(item.params, 0) || 0)
    {corners, rest} = Enum.split(items, max(count, 1))

    if count >= 3 and length(corners) == count and Enum.all?(corners, &corner?(&1, item)) do
      zone = {@polygons[command], {:polygon, for(corner <- corners, do: {corner.x, corner.y})}}
      zones(rest, seq + count, %{plan | fence: [zone | plan.fence]})
    else
      {:error, "item #{seq} begins a polygon of #{count} corners, which is not complete"}
    end
  end

  defp zones([item | _rest], seq, _plan),
    do: {:error, "item #{seq} has command #{item.command}, which is not part of a fence"}

  defp corner?(corner, first),
    do:
      corner.command == first.command and corner.params == first.params and corner.x != nil and
        corner.y != nil
end
