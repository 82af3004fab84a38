defmodule SimVehicle.Setpoints do
  @moduledoc """
  SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT as a goal of flight.

  The type mask says what to ignore: bits 0-2 position, 3-5 velocity, 6-8 acceleration, 10 yaw, 11 yaw rate. What
  cannot be flown (only part of a position, only an acceleration) is `:ignored`, as the firmware does silently.
  """

  import Bitwise

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Geo, Real32, Vehicle}
  alias SimVehicle.Flight.Goal

  @position 0x007
  @velocity 0x038
  @yaw 0x400
  @yaw_rate 0x800

  @local_frames [1, 7, 8, 9]
  @body_frames [8, 9]
  @global_frames %{0 => :amsl, 5 => :amsl, 3 => :relative, 6 => :relative, 10 => :relative, 11 => :relative}

  @doc "The goal that a setpoint asks for; velocities last `timeout_us` unless they are repeated."
  @spec goal(Vehicle.t(), struct, non_neg_integer) :: {:ok, Goal.t()} | :ignored
  def goal(v, %M.SetPositionTargetLocalNed{coordinate_frame: frame} = m, timeout_us)
      when frame in @local_frames do
    with {:ok, numbers} <- numbers([m.x, m.y, m.z], [m.vx, m.vy, m.vz], m.type_mask) do
      choose(v, m, numbers, timeout_us, fn [x, y, z] -> local(v, frame, x, y, z) end, &turn(v, frame, &1))
    end
  end

  def goal(v, %M.SetPositionTargetGlobalInt{} = m, timeout_us) do
    with {:ok, reference} <- Map.fetch(@global_frames, m.coordinate_frame),
         {:ok, numbers} <- numbers([0.0, 0.0, m.alt], [m.vx, m.vy, m.vz], m.type_mask) do
      choose(v, m, numbers, timeout_us, fn [_x, _y, alt] -> global(v, reference, m, alt) end, & &1)
    else
      _unknown -> :ignored
    end
  end

  def goal(_v, _message, _timeout_us), do: :ignored

  defp choose(v, m, {position, velocity}, timeout_us, place, turn) do
    cond do
      (m.type_mask &&& @position) == 0 ->
        {n, e, d} = place.(position)
        {:ok, Goal.goto(n, e, d, yaw: yaw_to(m))}

      (m.type_mask &&& @velocity) == 0 ->
        [vx, vy, vz] = velocity
        {vn, ve} = turn.({vx, vy})
        {:ok, Goal.velocity({vn, ve, vz}, yaw(m), v.now + timeout_us)}

      true ->
        :ignored
    end
  end

  # A NaN in a field that counts makes the whole setpoint void.
  defp numbers(position, velocity, mask) do
    used =
      if((mask &&& @position) == 0, do: position, else: []) ++
        if((mask &&& @velocity) == 0, do: velocity, else: [])

    if Enum.all?(used, &(is_number(&1) and abs(&1) < 1.0e7)), do: {:ok, {position, velocity}}, else: :ignored
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
