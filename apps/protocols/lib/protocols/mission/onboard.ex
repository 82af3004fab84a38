defmodule Protocols.Mission.Onboard do
  @moduledoc """
  A plan as a vehicle stores it: lists of items by mission type (0 mission, 1 fence, 2 rally points), as `Protocols.Mission.Transfer`
  sends and reads them, and back.
  """

  alias Protocols.Mission.{Item, Plan}
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
  @terrain MavFrame.value(:MAV_FRAME_GLOBAL_TERRAIN_ALT)

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

    Enum.flat_map(plan.fence, &zone/1) ++ back ++ plan.fence_others
  end

  def items(plan, 2, _protocol), do: Enum.map(plan.rally, &rally_item/1) ++ plan.rally_others

  @doc "The item of a rally point."
  @spec rally_item(Plan.rally_point()) :: Item.t()
  def rally_item({{x, y}, {z, frame}}), do: %Item{command: @rally, frame: frame, x: x, y: y, z: z}
  def rally_item({place, z}), do: rally_item({place, {z, @relative}})

  @doc "The rally point of an item; nil if it is not a place with a height above home, the sea or the ground."
  @spec rally_point(Item.t()) :: Plan.rally_point() | nil
  def rally_point(%{command: @rally, x: x, y: y, z: z} = item) when x != nil and y != nil and z != nil do
    case Item.plain_frame(item.frame) do
      @relative -> {{x, y}, z}
      frame when frame in [@global, @terrain] -> {{x, y}, {z, frame}}
      _no_height -> nil
    end
  end

  def rally_point(_other), do: nil

  @doc "A plan with one part replaced by the items of a vehicle."
  @spec put(Plan.t(), 0..2, [Item.t()], module()) :: Plan.t()
  def put(plan, 0, items, protocol) do
    {home, items} = if protocol.home_is_item_0?(), do: Enum.split(items, 1), else: {[], items}

    home =
      case home do
        [%Item{x: x, y: y, z: z}] when is_integer(x) and is_integer(y) and is_float(z) and {x, y} != {0, 0} ->
          {{x, y}, z}

        _none ->
          plan.home
      end

    %{plan | home: home, items: Enum.map(items, &jump(&1, -protocol.item_offset()))}
  end

  def put(plan, 1, items, _protocol),
    do: zones(items, %{plan | fence: [], fence_return: nil, fence_others: []})

  def put(plan, 2, items, _protocol) do
    {points, others} = Enum.split_with(items, &rally_point/1)
    %{plan | rally: Enum.map(points, &rally_point/1), rally_others: others}
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

  defp zones([], plan),
    do: %{plan | fence: Enum.reverse(plan.fence), fence_others: Enum.reverse(plan.fence_others)}

  # No firmware keeps the height of the return point, and ArduPilot gives it back as 0 above the sea.
  defp zones([%{command: @return, x: x, y: y} = item | rest], %{fence_return: nil} = plan)
       when x != nil and y != nil and (item.z in [nil, 0.0] or item.frame in [@relative, 6]),
       do: zones(rest, %{plan | fence_return: {{x, y}, item.z || 0.0}})

  defp zones([%{command: command, params: {radius, _, _, _}, x: x, y: y} | rest], plan)
       when is_map_key(@circles, command) and x != nil and y != nil and is_number(radius) and radius > 0,
       do: zones(rest, %{plan | fence: [{@circles[command], {:circle, {x, y}, radius}} | plan.fence]})

  defp zones([%{command: command} = item | rest] = items, plan) when is_map_key(@polygons, command) do
    count = trunc(elem(item.params, 0) || 0)
    {corners, others} = Enum.split(items, max(count, 1))

    if count >= 3 and length(corners) == count and Enum.all?(corners, &corner?(&1, item)) do
      zone = {@polygons[command], {:polygon, for(corner <- corners, do: {corner.x, corner.y})}}
      zones(others, %{plan | fence: [zone | plan.fence]})
    else
      other(item, rest, plan)
    end
  end

  defp zones([item | rest], plan), do: other(item, rest, plan)

  defp other(item, rest, plan), do: zones(rest, %{plan | fence_others: [item | plan.fence_others]})

  defp corner?(corner, first),
    do:
      corner.command == first.command and corner.params == first.params and corner.x != nil and
        corner.y != nil
end
