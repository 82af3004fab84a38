defmodule Aerie.Vehicle.Firmware.Px4.StoredItem do
  @moduledoc """
  What PX4 keeps of the items of a plan (mavlink_mission.cpp: `parse_mavlink_mission_item`, `format_mavlink_mission_item`; navigation.h:
  `mission_item_s`). An item with a place has a few fields of its own, with the yaw in radians; one without keeps all parameters.
  """

  alias Protocols.Mission.StoredItem
  alias MavCodec.Enums.{MavCmd, MavFrame}

  @mission 0
  @fence 1
  @frame_mission MavFrame.value(:MAV_FRAME_MISSION)
  # Degrees from radians of 32 bits: 123.4 comes back as 123.40001.
  @yaw_error 1.0e-3

  # Items with a place. A parameter that is not named is not kept.
  @places %{
    NAV_WAYPOINT: [param1: :float, param2: :float, param4: :yaw],
    NAV_LOITER_UNLIM: [param3: :float, param4: :yaw],
    NAV_LOITER_TIME: [param1: :float, param2: :flag, param3: :float, param4: :flag],
    NAV_LOITER_TO_ALT: [param1: :flag, param2: :float, param4: :flag],
    NAV_LAND: [param2: :two_bits, param4: :yaw],
    NAV_TAKEOFF: [param4: :yaw],
    NAV_VTOL_TAKEOFF: [param4: :yaw],
    NAV_VTOL_LAND: [param4: :yaw]
  }
  @by_place Map.new(@places, fn {name, fields} -> {MavCmd.value(:"MAV_CMD_#{name}"), fields} end)

  @corners [
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
  ]
  @return MavCmd.value(:MAV_CMD_NAV_FENCE_RETURN_POINT)
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @condition_delay MavCmd.value(:MAV_CMD_CONDITION_DELAY)
  @nav_delay MavCmd.value(:MAV_CMD_NAV_DELAY)

  @no_params %{param1: :any, param2: :any, param3: :any, param4: :any}

  @doc "`c:Protocols.Mission.Firmware.kept/3`."
  @spec item(map(), 0..2, kind :: String.t()) :: StoredItem.t()
  def item(%{frame: @frame_mission} = item, @mission, _kind), do: unset(item) |> Map.merge(command(item))

  def item(%{command: command} = item, @mission, _kind) when is_map_key(@by_place, command),
    do: Map.merge(@no_params, Map.new(@by_place[command], &field(&1, item)))

  def item(item, @mission, _kind), do: unset(item)

  # Fences have no heights.
  def item(%{command: command} = item, @fence, _kind),
    do:
      Map.merge(@no_params, %{
        param1: fence(command, elem(item.params, 0)),
        frame: :any,
        z: :any,
        autocontinue: :any
      })

  def item(_item, _rally, _kind), do: Map.put(@no_params, :autocontinue, :any)

  defp fence(@return, _unused), do: :any
  defp fence(command, count) when command in @corners, do: [trunc((count || 0.0) + 0.5)]
  defp fence(_circle, metres), do: [metres || 0.0]

  # It counts the repetitions with 16 bits: -1 comes back as 65535.
  defp command(%{command: @jump, params: {target, times, _, _}}) when is_number(target) and is_number(times),
    do: %{
      param1: StoredItem.whole(target, -0x8000..0x7FFF),
      param2: [times, trunc(times) |> Integer.mod(0x10000)]
    }

  defp command(%{command: @condition_delay}), do: %{command: [@condition_delay, @nav_delay]}
  defp command(_other), do: %{}

  # "Unset" comes back as it is, or as 0.
  defp unset(item) do
    fields = Enum.zip([:param1, :param2, :param3, :param4], Tuple.to_list(item.params)) ++ [z: item.z]
    for {name, nil} <- fields, into: %{}, do: {name, [nil, 0.0]}
  end

  defp field({name, how}, item) do
    index = %{param1: 0, param2: 1, param3: 2, param4: 3}[name]
    {name, kept(how, elem(item.params, index))}
  end

  # An unset yaw means that the vehicle chooses it.
  defp kept(:yaw, nil), do: [nil]
  defp kept(:yaw, degrees), do: {:angle, degrees, @yaw_error}
  defp kept(:float, nil), do: [nil, 0.0]
  defp kept(_how, nil), do: [0.0]
  defp kept(:float, number), do: [number]
  defp kept(:flag, number), do: [if(number > 0, do: 1.0, else: 0.0)]
  defp kept(:two_bits, number), do: StoredItem.whole(number, 0..3)
end
