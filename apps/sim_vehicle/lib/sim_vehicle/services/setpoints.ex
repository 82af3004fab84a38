defmodule SimVehicle.Services.Setpoints do
  @moduledoc """
  SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT as a goal of flight.

  The type mask says what to ignore: bits 0-2 position, 3-5 velocity, 6-8 acceleration, 10 yaw, 11 yaw rate. ArduCopter takes no notice of a
  position, velocity or acceleration of which one axis is masked, and stops if nothing is left
  (`GCS_MAVLINK_Copter::handle_message_set_position_target_local_ned`, `_global_int`; with both a position and a velocity
  `ModeGuided::set_destination_posvelaccel`, which moves the position with the velocity). PX4 goes by axis, and takes NaN for masked
  (`MavlinkReceiver::handle_message_set_position_target_local_ned`, `_global_int`).
  """

  import Bitwise

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Real32, Vehicle}
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Flight.Goal

  @position 0x007
  @velocity 0x038
  @acceleration 0x1C0
  @yaw 0x400
  @yaw_rate 0x800

  @local_frames [1, 7, 8, 9]
  @body_frames [8, 9]
  @px4_frames [1, 8]
  @global_frames %{0 => :amsl, 5 => :amsl, 3 => :relative, 6 => :relative, 10 => :relative, 11 => :relative}

  @doc "What ArduCopter makes of one; velocities and accelerations last `timeout_us` unless they are repeated."
  @spec whole(Vehicle.t(), struct, non_neg_integer) :: {:ok, Goal.t()} | :stop
  def whole(v, %module{coordinate_frame: frame, type_mask: mask} = m, timeout_us) do
    [place?, velocity?, acceleration?] =
      for bits <- [@position, @velocity, @acceleration], do: (mask &&& bits) == 0

    frame? =
      if module == M.SetPositionTargetLocalNed,
        do: frame in @local_frames,
        else: is_map_key(@global_frames, frame)

    counted =
      if(place?, do: place_values(m), else: []) ++
        if(velocity?, do: [m.vx, m.vy, m.vz], else: []) ++
        if(acceleration?, do: [m.afx, m.afy, m.afz], else: [])

    cond do
      not frame? or not Enum.all?(counted, &number?/1) ->
        :stop

      place? and velocity? ->
        {:ok, Goal.moving(place(v, m), velocity(v, m), yaw(m), v.now, v.now + timeout_us)}

      velocity? ->
        {:ok, Goal.velocity(velocity(v, m), yaw(m), v.now + timeout_us, {added(v, m, acceleration?), v.now})}

      place? and acceleration? ->
        :stop

      place? ->
        {:ok, goto(v, m)}

      acceleration? ->
        {:ok,
         Goal.velocity({v.kin.vn, v.kin.ve, v.kin.vd}, yaw(m), v.now + timeout_us, {added(v, m, true), v.now})}

      true ->
        :stop
    end
  end

  def whole(_v, _message, _timeout_us), do: :stop

  defp added(_v, _m, false), do: {0.0, 0.0, 0.0}

  defp added(v, m, true) do
    {an, ae} = turn(v, m.coordinate_frame, {m.afx, m.afy})
    {an, ae, m.afz}
  end

  @doc "What PX4 makes of one, `:ignored` if nothing counts."
  @spec by_axis(Vehicle.t(), struct, non_neg_integer) :: {:ok, Goal.t()} | :ignored
  def by_axis(_v, %M.SetPositionTargetLocalNed{coordinate_frame: frame}, _us) when frame not in @px4_frames,
    do: :ignored

  def by_axis(_v, %M.SetPositionTargetGlobalInt{coordinate_frame: frame}, _us)
      when not is_map_key(@global_frames, frame),
      do: :ignored

  def by_axis(v, %{type_mask: mask} = m, timeout_us) do
    {n, e, d} = place_by_axis(v, m)
    {vn, ve} = turn(v, m.coordinate_frame, {axis(m.vx, mask, 3) || 0.0, axis(m.vy, mask, 4) || 0.0})
    {an, ae} = turn(v, m.coordinate_frame, {axis(m.afx, mask, 6) || 0.0, axis(m.afy, mask, 7) || 0.0})

    xy =
      cond do
        n && e -> {:pos, n, e}
        axis(m.vx, mask, 3) || axis(m.vy, mask, 4) -> {:vel, vn, ve}
        axis(m.afx, mask, 6) || axis(m.afy, mask, 7) -> {:acc, an, ae}
        true -> nil
      end

    z =
      cond do
        d -> {:pos, d}
        vd = axis(m.vz, mask, 5) -> {:vel, vd}
        ad = axis(m.afz, mask, 8) -> {:acc, ad}
        true -> nil
      end

    case {xy, z} do
      {nil, nil} -> :ignored
      {{:pos, n, e}, {:pos, d}} -> {:ok, Goal.goto(n, e, d, yaw: yaw_to(m))}
      {xy, z} -> {:ok, Goal.axes(xy || {:vel, 0.0, 0.0}, z || {:vel, 0.0}, yaw(m), v.now + timeout_us)}
    end
  end

  # Positions in the body's frame count nothing, and of a global one all or nothing.
  defp place_by_axis(_v, %M.SetPositionTargetLocalNed{coordinate_frame: 8}), do: {nil, nil, nil}

  defp place_by_axis(_v, %M.SetPositionTargetLocalNed{type_mask: mask} = m),
    do: {axis(m.x, mask, 0), axis(m.y, mask, 1), axis(m.z, mask, 2)}

  defp place_by_axis(v, m),
    do: if((m.type_mask &&& @position) == 0 and number?(m.alt), do: place(v, m), else: {nil, nil, nil})

  defp axis(value, mask, bit), do: if((mask >>> bit &&& 1) == 0 and number?(value), do: value)
  defp number?(value), do: is_number(value) and abs(value) < 1.0e7

  defp place_values(%M.SetPositionTargetLocalNed{} = m), do: [m.x, m.y, m.z]
  defp place_values(m), do: [m.alt]

  defp place(v, %M.SetPositionTargetLocalNed{} = m), do: local(v, m.coordinate_frame, m.x, m.y, m.z)
  defp place(v, m), do: global(v, Map.fetch!(@global_frames, m.coordinate_frame), m, m.alt)

  defp goto(v, m) do
    {n, e, d} = place(v, m)
    Goal.goto(n, e, d, yaw: yaw_to(m))
  end

  defp velocity(v, m) do
    {vn, ve} = turn(v, m.coordinate_frame, {m.vx, m.vy})
    {vn, ve, m.vz}
  end

  defp local(v, frame, x, y, z) do
    {n, e} = turn(v, frame, {x, y})
    if frame == 1, do: {n, e, z * 1.0}, else: {v.kin.n + n, v.kin.e + e, v.kin.d + z}
  end

  defp global(v, reference, m, alt) do
    {n, e} = Geo.to_local(v.origin, m.lat_int, m.lon_int)
    base = if reference == :amsl, do: 0.0, else: (v.home || v.origin).alt
    {n, e, v.origin.alt - base - alt}
  end

  defp turn(v, frame, {x, y}) when frame in @body_frames do
    {cos, sin} = {:math.cos(v.kin.yaw), :math.sin(v.kin.yaw)}
    {x * cos - y * sin, x * sin + y * cos}
  end

  defp turn(_v, _frame, xy), do: xy

  defp yaw_to(m), do: if((m.type_mask &&& @yaw) == 0, do: Real32.number(m.yaw))

  defp yaw(m) do
    cond do
      (m.type_mask &&& @yaw) == 0 and Real32.number(m.yaw) != nil -> {:to, m.yaw}
      (m.type_mask &&& @yaw_rate) == 0 and Real32.number(m.yaw_rate) != nil -> {:rate, m.yaw_rate}
      true -> :keep
    end
  end
end
