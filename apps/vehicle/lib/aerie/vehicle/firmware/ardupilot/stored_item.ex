defmodule Aerie.Vehicle.Firmware.Ardupilot.StoredItem do
  @moduledoc """
  What ArduPilot keeps of the items of a plan.

  A mission item has 15 bytes: a 16-bit number, and either a place with its height in centimetres or a small structure of its
  command (AP_Mission.cpp: `mavlink_int_to_mission_cmd`, `mission_cmd_to_mavlink_int`, `stored_in_location`; AP_Mission.h). The frame and the
  place of other commands are lost. Rally points have whole metres (MissionItemProtocol_Rally.cpp), and circles of a fence had them up
  to 4.0 (AC_PolyFence_loader.cpp). autocontinue is never kept.
  """

  alias Protocols.Mission.{Item, StoredItem}
  alias MavCodec.Enums.MavCmd

  @mission 0
  @fence 1
  @global 0
  @frame_mission 2

  # ArduPlane and its quadplanes.
  @planes ["plane", "vtol"]

  # `:places` - commands with a place; the others have none. A parameter that is not named is not kept.
  @places [
    NAV_WAYPOINT: [param1: :u16],
    NAV_LOITER_UNLIM: [param3: :signed_u16],
    NAV_LOITER_TURNS: [param1: :turns, param3: :turn_radius, param4: :flag],
    NAV_LOITER_TIME: [param1: :u16, param3: :sign, param4: :flag],
    NAV_LAND: [param1: :u16, param4: :sign],
    NAV_TAKEOFF: [param1: :u16],
    NAV_CONTINUE_AND_CHANGE_ALT: [param1: :u16],
    NAV_LOITER_TO_ALT: [param2: :signed_u16, param4: :flag],
    NAV_SPLINE_WAYPOINT: [param1: :u16],
    NAV_VTOL_TAKEOFF: [],
    NAV_VTOL_LAND: [param1: {:newer, :u16}],
    NAV_GUIDED_ENABLE: [param1: :u16],
    NAV_PAYLOAD_PLACE: [param1: :cm],
    DO_SET_HOME: [param1: :u16],
    DO_RETURN_PATH_START: [],
    DO_LAND_START: [],
    DO_GO_AROUND: [],
    DO_SET_ROI_LOCATION: [param1: {:newer, :u16}],
    DO_SET_ROI: [param1: :u16]
  ]
  @others [
    NAV_RETURN_TO_LAUNCH: [],
    NAV_ALTITUDE_WAIT: [param1: :float, param2: :float, param3: :u8],
    NAV_DELAY: [param1: :float, param2: :i8, param3: :i8, param4: :i8],
    NAV_SET_YAW_SPEED: [param1: :float, param2: :float, param3: :u8],
    NAV_SCRIPT_TIME: [param1: :u8, param2: :u8, param3: :half, param4: :half, x: :i16, y: :i16],
    NAV_ATTITUDE_TIME: [param1: :u16, param2: :i16, param3: :i8, param4: :i16, x: :i16],
    CONDITION_DELAY: [param1: :float],
    CONDITION_DISTANCE: [param1: :float],
    CONDITION_YAW: [param1: :float, param2: :float, param3: :i8, param4: :u8],
    DO_SET_MODE: [param1: :u16],
    DO_JUMP: [param1: :u16, param2: :i16],
    JUMP_TAG: [param1: :u16],
    DO_JUMP_TAG: [param1: :u16, param2: :i16],
    DO_CHANGE_SPEED: [param1: :u8, param2: :float, param3: :float],
    DO_SET_RELAY: [param1: :u8, param2: :u8],
    DO_REPEAT_RELAY: [param1: :u8, param2: :i16, param3: :float],
    DO_SET_SERVO: [param1: :u8, param2: :u16],
    DO_REPEAT_SERVO: [param1: :u8, param2: :u16, param3: :i16, param4: :float],
    DO_PAUSE_CONTINUE: [param1: :u16],
    DO_SET_REVERSE: [param1: :u16],
    DO_SET_ROI_NONE: [param1: {:newer, :u16}],
    DO_DIGICAM_CONFIGURE: [
      param1: :u8,
      param2: :u16,
      param3: :u8,
      param4: :u16,
      x: :u8,
      y: :u8,
      z: :float
    ],
    DO_DIGICAM_CONTROL: [param1: :u8, param2: :u8, param3: :i8, param4: :u8, x: :u8, y: :u8],
    DO_MOUNT_CONTROL: [param1: :float, param2: :float, param3: :float],
    DO_SET_CAM_TRIGG_DIST: [param1: :float, param3: {:newer, :u8}],
    DO_FENCE_ENABLE: [param1: :u16],
    DO_PARACHUTE: [param1: :u16],
    DO_INVERTED_FLIGHT: [param1: :u16],
    DO_GRIPPER: [param1: :u8, param2: :u8],
    DO_AUTOTUNE_ENABLE: [param1: :u16],
    DO_SET_RESUME_REPEAT_DIST: [param1: :u16],
    DO_SPRAYER: [param1: :u16],
    DO_SEND_SCRIPT_MESSAGE: [param1: :u16, param2: :float, param3: :float, param4: :float],
    DO_AUX_FUNCTION: [param1: :u16, param2: :u8],
    DO_GUIDED_LIMITS: [param1: :u16, param2: :float, param3: :float, param4: :float],
    DO_ENGINE_CONTROL: [param1: :flag, param2: :flag, param3: :cm, param4: {:newer, :flag}],
    SET_CAMERA_ZOOM: [param1: :u8, param2: :float],
    SET_CAMERA_FOCUS: [param1: :u8, param2: :float],
    SET_CAMERA_SOURCE: [param1: :u8, param2: :u8, param3: :u8],
    DO_GIMBAL_MANAGER_PITCHYAW: [
      param1: :i8,
      param2: :i16,
      param3: :i8,
      param4: :i8,
      x: :u8,
      z: :u8
    ],
    IMAGE_START_CAPTURE: [param1: :u8, param2: :float, param3: :u16, param4: :u16],
    IMAGE_STOP_CAPTURE: [param1: :u8],
    VIDEO_START_CAPTURE: [param1: :u8],
    VIDEO_STOP_CAPTURE: [param1: :u8],
    DO_VTOL_TRANSITION: [param1: :u8],
    DO_WINCH: [param1: :u8, param2: :u8, param3: :float, param4: :float]
  ]

  numbered = fn rows ->
    Map.new(rows, fn {name, fields} -> {MavCmd.value(:"MAV_CMD_#{name}") || raise("#{name}"), fields} end)
  end

  @by_place numbered.(@places)
  @by_number numbered.(@others)
  @waypoint MavCmd.value(:MAV_CMD_NAV_WAYPOINT)
  # The number of its corners is the shape of a fence.
  @corners [
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
  ]
  @circles [
    MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION),
    MavCmd.value(:MAV_CMD_NAV_FENCE_HOME_CIRCLE_INCLUSION)
  ]

  @nothing %{param1: :any, param2: :any, param3: :any, param4: :any, autocontinue: :any}
  @integers %{
    u8: 0..0xFF,
    i8: -0x80..0x7F,
    u16: 0..0xFFFF,
    i16: -0x8000..0x7FFF
  }

  @doc "`c:Protocols.Mission.Firmware.kept/3`."
  @spec item(map(), 0..2, kind :: String.t()) :: StoredItem.t()
  def item(item, @mission, kind), do: mission(item, kind)

  def item(%{command: command} = item, @fence, _kind) do
    Map.merge(@nothing, %{param1: fence(command, elem(item.params, 0)), frame: :any, z: :any})
  end

  def item(item, _rally, _kind), do: Map.put(@nothing, :z, StoredItem.cut(item.z || 0.0, 1))

  defp fence(command, count) when command in @corners, do: [count || 0.0]
  defp fence(command, metres) when command in @circles, do: [metres || 0.0, trunc(metres || 0.0)]
  defp fence(_return_point, _unused), do: :any

  defp mission(%{command: command} = item, kind) when is_map_key(@by_place, command) do
    fields = if command == @waypoint and kind in @planes, do: plane(), else: @by_place[command]
    Map.merge(@nothing, Map.merge(place(item), fields(fields, item)))
  end

  defp mission(%{command: command} = item, _kind) when is_map_key(@by_number, command),
    do:
      Map.merge(
        @nothing,
        Map.merge(%{frame: :any, x: :any, y: :any, z: :any}, fields(@by_number[command], item))
      )

  # A command that is not known here: all of it counts, but what no item keeps.
  defp mission(item, _kind) do
    item |> place() |> Map.merge(unset(item)) |> Map.put(:autocontinue, :any) |> without_place(item)
  end

  defp without_place(kept, item),
    do: if(MavCmd.location?(item.command) == false, do: %{kept | frame: :any, z: :any}, else: kept)

  # The acceptance radius and the distance at which it is passed share the number.
  defp plane, do: [param2: :byte, param3: :byte]

  defp place(item) do
    frame = if item.frame == @frame_mission, do: @global, else: Item.plain_frame(item.frame)
    %{frame: [frame], x: [item.x || 0], y: [item.y || 0], z: StoredItem.cut(item.z || 0.0, 100)}
  end

  defp unset(item) do
    for {name, nil} <- Enum.zip([:param1, :param2, :param3, :param4], Tuple.to_list(item.params)),
        into: %{},
        do: {name, [nil, 0.0]}
  end

  defp fields(fields, item), do: Map.new(fields, fn {name, how} -> {name, kept(how, value(item, name))} end)

  defp value(%{params: {value, _, _, _}}, :param1), do: value
  defp value(%{params: {_, value, _, _}}, :param2), do: value
  defp value(%{params: {_, _, value, _}}, :param3), do: value
  defp value(%{params: {_, _, _, value}}, :param4), do: value
  defp value(item, name), do: Map.fetch!(item, name)

  # ArduPilot stores unset values as 0.
  defp kept(:sign, nil), do: [1.0]
  defp kept(_how, nil), do: [0.0, nil]
  defp kept(:float, number), do: [number]
  defp kept(:flag, number), do: [if(number > 0, do: 1.0, else: 0.0)]
  defp kept(:sign, number), do: [if(number < 0, do: -1.0, else: 1.0)]
  defp kept(:cm, number), do: StoredItem.cut(number, 100)
  defp kept(:half, number), do: {:near, [number], abs(number) * 0.001 + 1.0e-7}
  # Older versions do not keep it.
  defp kept({:newer, how}, number), do: [0.0 | kept(how, number)]
  defp kept(:byte, number) when number >= 0, do: [min(trunc(number), 255)]
  defp kept(:byte, number), do: [number]

  # Fractions of one turn have a form of their own, as of 4.4.
  defp kept(:turns, number) when number > 0 and number < 1, do: [trunc(number * 256) / 256, 0.0]
  defp kept(:turns, number), do: kept(:byte, number)

  defp kept(:turn_radius, metres) do
    far = abs(metres)
    kept = if far <= 255, do: trunc(far), else: min(255, trunc(far * 0.1)) * 10
    [if(metres < 0, do: -kept, else: kept)]
  end

  defp kept(:signed_u16, number) do
    [kept] = StoredItem.whole(abs(number), @integers.u16)
    [if(number < 0, do: -kept, else: kept)]
  end

  defp kept(integer, number), do: StoredItem.whole(number, Map.fetch!(@integers, integer))
end
