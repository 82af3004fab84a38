defmodule SimVehicle.Plans.Storage do
  @moduledoc """
  An item of a plan after the firmware has stored it and read it again.

  ArduPilot packs a mission item into a 16-bit number and at most 12 bytes: a place, or the structure of the command
  (AP_Mission.cpp: `mavlink_int_to_mission_cmd`, `stored_in_location`, `write_cmd_to_storage`, `mission_cmd_to_mavlink_int`; AP_Mission.h).
  Rally points are `RallyLocation` (AP_Rally.h) with whole metres, a fence has counts and radii (AC_PolyFence_loader.cpp).

  PX4 has a few fields for an item with a place, and seven parameters for the others (mavlink_mission.cpp: `parse_mavlink_mission_item`,
  `format_mavlink_mission_item`).
  """

  import Bitwise
  import MavCodec.Command

  alias SimVehicle.Real32

  # Commands whose content is a place; what they keep in the 16-bit number.
  @places cmds(~w(
    NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_LAND NAV_TAKEOFF
    NAV_CONTINUE_AND_CHANGE_ALT NAV_LOITER_TO_ALT NAV_SPLINE_WAYPOINT NAV_VTOL_TAKEOFF NAV_VTOL_LAND
    NAV_GUIDED_ENABLE NAV_PAYLOAD_PLACE DO_SET_HOME DO_RETURN_PATH_START DO_LAND_START DO_GO_AROUND
    DO_SET_ROI_LOCATION DO_SET_ROI
  )a)
  # Fields in the order of the structure: a parameter by its number, or x, y, z.
  @structures %{
    cmd(:NAV_ALTITUDE_WAIT) => [f32: 1, f32: 2, u8: 3],
    cmd(:NAV_DELAY) => [f32: 1, i8: 2, i8: 3, i8: 4],
    cmd(:CONDITION_DELAY) => [f32: 1],
    cmd(:CONDITION_DISTANCE) => [f32: 1],
    cmd(:CONDITION_YAW) => [f32: 1, f32: 2, i8: 3, u8: 4],
    cmd(:DO_JUMP) => [u16: 1, i16: 2],
    cmd(:DO_CHANGE_SPEED) => [u8: 1, f32: 2, f32: 3],
    cmd(:DO_SET_RELAY) => [u8: 1, u8: 2],
    cmd(:DO_REPEAT_RELAY) => [u8: 1, i16: 2, f32: 3],
    cmd(:DO_SET_SERVO) => [u8: 1, u16: 2],
    cmd(:DO_REPEAT_SERVO) => [u8: 1, u16: 2, i16: 3, f32: 4],
    cmd(:DO_DIGICAM_CONFIGURE) => [u8: 1, u16: 2, u8: 3, u16: 4, u8: :x, u8: :y, f32: :z],
    cmd(:DO_DIGICAM_CONTROL) => [u8: 1, u8: 2, i8: 3, u8: 4, u8: :x, u8: :y],
    cmd(:DO_MOUNT_CONTROL) => [f32: 1, f32: 2, f32: 3],
    cmd(:DO_SET_CAM_TRIGG_DIST) => [f32: 1, u8: 3],
    cmd(:DO_GRIPPER) => [u8: 1, u8: 2],
    cmd(:NAV_SET_YAW_SPEED) => [f32: 1, f32: 2, u8: 3],
    cmd(:DO_AUX_FUNCTION) => [u16: 1, u8: 2],
    cmd(:DO_GIMBAL_MANAGER_PITCHYAW) => [i8: 1, i16: 2, i8: 3, i8: 4, u8: :x, u8: :z],
    cmd(:IMAGE_START_CAPTURE) => [u8: 1, f32: 2, u16: 3, u16: 4],
    cmd(:IMAGE_STOP_CAPTURE) => [u8: 1],
    cmd(:VIDEO_START_CAPTURE) => [u8: 1],
    cmd(:VIDEO_STOP_CAPTURE) => [u8: 1],
    cmd(:DO_VTOL_TRANSITION) => [u8: 1]
  }
  @polygons cmds(~w(NAV_FENCE_POLYGON_VERTEX_INCLUSION NAV_FENCE_POLYGON_VERTEX_EXCLUSION)a)
  @global 0
  @relative 3
  @terrain 10
  # MAV_MOUNT_MODE_MAVLINK_TARGETING: DO_MOUNT_CONTROL has no other mode in a mission.
  @targeting 2.0

  @doc "Whether ArduPilot stores a command of a mission as a place."
  @spec place?(integer()) :: boolean()
  def place?(command), do: command in @places

  @doc "The item as it is read back."
  @spec kept(SimVehicle.Plans.item(), :ardupilot | :px4, 0..2) :: SimVehicle.Plans.item()
  def kept(item, style, type)

  def kept(%{command: command} = item, :ardupilot, 0) when command in @places do
    {p1, flags} = number(command, item)
    z = item.z
    cm = trunc(Real32.round32(z * 100.0))
    content = <<flags::8, cm::24, item.x::32, item.y::32>>
    <<flags::8, cm::signed-24, x::signed-32, y::signed-32>> = content
    alt = Real32.round32(cm * Real32.round32(0.01))
    params = params(command, p1 &&& 0xFFFF, flags)
    %{item | frame: frame(item.frame), params: params, x: x, y: y, z: alt, autocontinue: 1}
  end

  def kept(%{command: command} = item, :ardupilot, 0) do
    empty = %{item | frame: @global, params: {0.0, 0.0, 0.0, 0.0}, x: 0, y: 0, z: 0.0, autocontinue: 1}

    case @structures do
      %{^command => fields} -> unpacked(empty, fields, packed(item, fields)) |> mount()
      # RETURN_TO_LAUNCH has nothing.
      _number_only when command == cmd(:NAV_RETURN_TO_LAUNCH) -> empty
      _number_only -> put(empty, 1, (whole(item, 1) &&& 0xFFFF) / 1)
    end
  end

  def kept(item, :ardupilot, 1) do
    p1 = if item.command == cmd(:NAV_FENCE_RETURN_POINT), do: 0.0, else: value(item, 1)
    %{item | frame: @global, params: {p1, 0.0, 0.0, 0.0}, z: 0.0, autocontinue: 0}
  end

  def kept(item, :ardupilot, 2) do
    metres = trunc(item.z) / 1
    %{item | frame: frame(item.frame), params: {0.0, 0.0, 0.0, 0.0}, z: metres, autocontinue: 0}
  end

  def kept(item, :px4, 1) do
    p1 =
      case item.command do
        cmd(:NAV_FENCE_RETURN_POINT) -> 0.0
        polygon when polygon in @polygons -> trunc(value(item, 1) + 0.5) / 1
        _circle -> value(item, 1)
      end

    %{item | frame: @global, params: {p1, 0.0, 0.0, 0.0}, z: 0.0, autocontinue: 0}
  end

  def kept(item, :px4, 2), do: %{item | params: {0.0, 0.0, 0.0, 0.0}}
  # The kind of delay is lost.
  def kept(%{command: cmd(:CONDITION_DELAY)} = item, :px4, 0), do: %{item | command: cmd(:NAV_DELAY)}

  def kept(%{command: cmd(:DO_JUMP), params: {to, times, p3, p4}} = item, :px4, 0) do
    <<to::signed-16, times::16>> = <<whole(to)::16, whole(times)::16>>
    %{item | params: {to / 1, times / 1, p3, p4}}
  end

  def kept(item, :px4, 0), do: %{item | params: params_px4(item.command, item.params)}

  defp params_px4(cmd(:NAV_WAYPOINT), {p1, p2, _p3, p4}), do: {p1, p2, 0.0, yaw(p4)}
  defp params_px4(cmd(:NAV_LOITER_UNLIM), {_p1, _p2, p3, p4}), do: {0.0, 0.0, p3, yaw(p4)}
  defp params_px4(cmd(:NAV_LOITER_TIME), {p1, p2, p3, p4}), do: {p1, flag(p2), p3, flag(p4)}
  defp params_px4(cmd(:NAV_LAND), {_p1, p2, _p3, p4}), do: {0.0, (whole(p2) &&& 3) / 1, 0.0, yaw(p4)}
  defp params_px4(cmd(:NAV_LOITER_TO_ALT), {p1, p2, _p3, p4}), do: {flag(p1), p2, 0.0, flag(p4)}

  defp params_px4(command, {_p1, _p2, _p3, p4})
       when command in cmds(~w(NAV_TAKEOFF NAV_VTOL_TAKEOFF NAV_VTOL_LAND)a),
       do: {0.0, 0.0, 0.0, yaw(p4)}

  defp params_px4(_command, params), do: params

  # --- ArduPilot

  # `loiter_ccw`, `loiter_xtrack` and the bits for far circles and parts of a turn.
  @ccw 1
  @xtrack 2
  @far 4
  @part 8

  defp number(cmd(:NAV_LOITER_TURNS), item) do
    turns = value(item, 1)
    part? = turns > 0 and turns < 1
    low = if part?, do: trunc(turns * 256), else: min(255, trunc(turns))
    radius = abs(value(item, 3))
    far? = radius > 255
    high = if far?, do: min(255, trunc(radius * 0.1)), else: trunc(radius)

    {bor(high <<< 8, low &&& 0xFF),
     bits([
       {@ccw, value(item, 3) < 0},
       {@xtrack, value(item, 4) > 0},
       {@far, far?},
       {@part, part?}
     ])}
  end

  defp number(cmd(:NAV_LOITER_UNLIM), item),
    do: {trunc(abs(value(item, 3))), bits([{@ccw, value(item, 3) < 0}])}

  defp number(cmd(:NAV_LOITER_TIME), item),
    do: {whole(item, 1), bits([{@ccw, value(item, 3) < 0}, {@xtrack, value(item, 4) > 0}])}

  defp number(cmd(:NAV_LAND), item), do: {whole(item, 1), bits([{@ccw, value(item, 4) < 0}])}

  defp number(cmd(:NAV_LOITER_TO_ALT), item),
    do: {trunc(abs(value(item, 2))), bits([{@ccw, value(item, 2) < 0}, {@xtrack, value(item, 4) > 0}])}

  defp number(cmd(:NAV_PAYLOAD_PLACE), item), do: {trunc(value(item, 1) * 100), 0}

  defp number(command, _item)
       when command in cmds(~w(NAV_VTOL_TAKEOFF DO_RETURN_PATH_START DO_LAND_START DO_GO_AROUND)a), do: {0, 0}

  # The delay of a copter.
  defp number(_command, item), do: {whole(item, 1), 0}

  defp params(cmd(:NAV_LOITER_TURNS), p1, flags) do
    radius = (p1 >>> 8) * if(set?(flags, @far), do: 10, else: 1)
    turns = (p1 &&& 0xFF) / if(set?(flags, @part), do: 256, else: 1)
    {turns, 0.0, sign(flags) * radius, xtrack(flags)}
  end

  defp params(cmd(:NAV_LOITER_UNLIM), p1, flags), do: {0.0, 0.0, sign(flags) * p1, 0.0}
  defp params(cmd(:NAV_LOITER_TIME), p1, flags), do: {p1 / 1, 0.0, sign(flags), xtrack(flags)}
  defp params(cmd(:NAV_LAND), p1, flags), do: {p1 / 1, 0.0, 0.0, sign(flags)}
  defp params(cmd(:NAV_LOITER_TO_ALT), p1, flags), do: {0.0, sign(flags) * p1, 0.0, xtrack(flags)}
  defp params(cmd(:NAV_PAYLOAD_PLACE), p1, _flags), do: {Real32.round32(p1 / 100), 0.0, 0.0, 0.0}
  defp params(_command, p1, _flags), do: {p1 / 1, 0.0, 0.0, 0.0}

  defp bits(flags), do: for({bit, true} <- flags, reduce: 0, do: (all -> all ||| bit))
  defp set?(flags, bit), do: (flags &&& bit) != 0
  defp sign(flags), do: if(set?(flags, @ccw), do: -1.0, else: 1.0)
  defp xtrack(flags), do: if(set?(flags, @xtrack), do: 1.0, else: 0.0)

  defp frame(frame) when frame in [3, 6], do: @relative
  defp frame(frame) when frame in [10, 11], do: @terrain
  defp frame(_global), do: @global

  defp packed(item, fields) do
    for {type, from} <- fields, into: <<>> do
      case type do
        :f32 -> <<value(item, from)::float-32>>
        type when type in [:u8, :i8] -> <<whole(item, from)::8>>
        type when type in [:u16, :i16] -> <<whole(item, from)::16>>
      end
    end
  end

  defp unpacked(item, [], <<>>), do: item

  defp unpacked(item, [{type, to} | fields], bytes) do
    {value, rest} =
      case {type, bytes} do
        {:f32, <<value::float-32, rest::binary>>} -> {value, rest}
        {:u8, <<value::8, rest::binary>>} -> {value, rest}
        {:i8, <<value::signed-8, rest::binary>>} -> {value, rest}
        {:u16, <<value::16, rest::binary>>} -> {value, rest}
        {:i16, <<value::signed-16, rest::binary>>} -> {value, rest}
      end

    unpacked(put(item, to, value), fields, rest)
  end

  defp mount(%{command: cmd(:DO_MOUNT_CONTROL)} = item), do: %{item | z: @targeting}
  defp mount(item), do: item

  defp value(item, from) when is_integer(from), do: Real32.number(elem(item.params, from - 1)) || 0.0
  defp value(item, from), do: Real32.number(Map.fetch!(item, from)) || 0.0
  defp whole(item, from), do: trunc(value(item, from))

  defp put(item, to, value) when is_integer(to),
    do: %{item | params: put_elem(item.params, to - 1, value / 1)}

  defp put(item, :z, value), do: %{item | z: value / 1}
  defp put(item, to, value), do: Map.put(item, to, value)

  # --- PX4

  # In radians, between 0 and two pi (`matrix::wrap_2pi`), in 32 bits.
  defp yaw(degrees) when is_number(degrees) do
    radians = Real32.round32(degrees * Real32.round32(:math.pi() / 180))
    turn = Real32.round32(2 * :math.pi())
    wrapped = Real32.round32(radians - turn * Float.floor(radians / turn))
    Real32.round32(wrapped * Real32.round32(180 / :math.pi()))
  end

  defp yaw(unset), do: unset

  defp flag(value), do: if(is_number(value) and value > 0, do: 1.0, else: 0.0)
  defp whole(value), do: trunc(Real32.number(value) || 0.0)
end
