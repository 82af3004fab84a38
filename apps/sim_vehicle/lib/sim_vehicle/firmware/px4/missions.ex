defmodule SimVehicle.Firmware.Px4.Missions do
  @moduledoc """
  PX4's specifics of missions: the feasibility check after the upload, reached items repeated every second, the end of a
  mission.
  """

  import MavCodec.Command

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Plans, Vehicle}
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Flight.Mission
  alias SimVehicle.Firmware.Px4.{Events, Internal, Modes}

  @repeat_us 1_010_000
  @repeat_for_us 10_200_000
  @far_m 10_000
  @nav cmds(~w(NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_LAND NAV_TAKEOFF)a)

  @doc "A plan was replaced or cleared. An accepted mission may still be rejected, which only an event reports."
  @spec plan_changed(Vehicle.t(), :stored | :cleared, 0..2) :: Vehicle.t()
  def plan_changed(v, _kind, 0) do
    v =
      v
      |> Mission.reset()
      |> Vehicle.put_own(:reached, nil)
      |> Vehicle.put_own(:mission_feasible, true)
      |> Vehicle.put_own(:task, nil)

    check(v, Plans.items(v.plans, 0))
  end

  def plan_changed(v, :stored, 1) do
    corners =
      for %{command: cmd(:NAV_FENCE_POLYGON_VERTEX_EXCLUSION)} = item <- Plans.items(v.plans, 1),
          do: Geo.to_local(v.origin, item.x, item.y)

    home = v.home && Geo.to_local(v.origin, v.home.lat, v.home.lon)

    if home && length(corners) >= 3 && Geo.inside?(corners, home),
      do: Events.emit(v, :geofence_invalid, [], {2, "Geofence invalid, doesn't contain Home position"}),
      else: v
  end

  def plan_changed(v, _kind, _type), do: v

  @active 3
  @complete 5

  @doc """
  The state that MISSION_CURRENT shows: that of the navigator's last task, which a take-off or a landing is as well, so
  that a mission that was never flown can be "complete".
  """
  @spec shown_state(Vehicle.t(), 0..5) :: 0..5
  def shown_state(%{mission: %{state: :none}}, state), do: state

  def shown_state(v, state) do
    task = Vehicle.own(v, :task)

    cond do
      v.armed and task == :running and v.mode in ["AUTO_TAKEOFF", "AUTO_LAND"] -> @active
      task == :done and v.mission.state != :active -> @complete
      true -> state
    end
  end

  @doc "Item `seq` was reached, or carried out."
  @spec reached(Vehicle.t(), non_neg_integer) :: Vehicle.t()
  def reached(v, seq), do: Vehicle.put_own(v, :reached, %{seq: seq, since: v.now, next: v.now})

  @doc "Repeats the last reached item every second for ten seconds."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(v) do
    case Vehicle.own(v, :reached) do
      %{since: since} when v.now - since > @repeat_for_us ->
        Vehicle.put_own(v, :reached, nil)

      %{next: next, seq: seq} = reached when v.now >= next ->
        v
        |> Vehicle.put_own(:reached, %{reached | next: next + @repeat_us})
        |> Vehicle.emit(%M.MissionItemReached{seq: seq})

      _nothing_due ->
        v
    end
  end

  @doc "The end of the mission."
  @spec done(Vehicle.t()) :: Vehicle.t()
  def done(v) do
    v = Events.emit(v, :mission_finished, [], {6, "Mission finished, loitering"})
    if v.mode == "AUTO_MISSION", do: Modes.enter(v, "AUTO_LOITER"), else: v
  end

  @doc "An RTL item ends the mission: it is a command of the navigator to the commander."
  @spec rtl(Vehicle.t()) :: {:vehicle, Vehicle.t()}
  def rtl(v) do
    v = reached(v, v.mission.current)
    v = %{v | mission: %{v.mission | state: :complete}}

    {:vehicle,
     v
     |> Events.emit(:mission_finished, [], {6, "Mission finished, loitering"})
     |> Internal.send(cmd(:NAV_RETURN_TO_LAUNCH), [])
     |> Modes.enter("AUTO_RTL")}
  end

  defp check(v, []), do: v

  defp check(v, [first | _rest] = items) do
    cond do
      Enum.any?(items, &(nav?(&1) and (abs(&1.x) > 900_000_000 or abs(&1.y) > 1_800_000_000))) ->
        infeasible(Events.emit(v, :mission_item_invalid, [], {2, "IGN MISSION_ITEM: Invalid item"}))

      Params.get(v.params, "MIS_TKO_LAND_REQ") == 1 and first.command != cmd(:NAV_TAKEOFF) ->
        infeasible(
          Events.emit(v, :mission_takeoff_missing, [], {2, "Mission rejected: Takeoff waypoint required"})
        )

      far(v, items) > @far_m ->
        far = far(v, items)
        text = "First waypoint far away from Home: #{far} m Correct mission loaded?"
        Events.emit(v, :first_waypoint_far, [far], {4, text})

      true ->
        v
    end
  end

  defp infeasible(v), do: %{Vehicle.put_own(v, :mission_feasible, false) | mission: Mission.new()}

  defp far(v, items) do
    case Enum.find(items, &(nav?(&1) and &1.x != 0)) do
      nil ->
        0

      item ->
        {n, e} = Geo.to_local(v.origin, item.x, item.y)
        round(:math.sqrt(n * n + e * e))
    end
  end

  defp nav?(item), do: item.command in @nav and item.frame != 2
end
