defmodule SimVehicle.Flight.Mission do
  @moduledoc """
  Flies the uploaded mission: which item is next, what it asks for, when it is reached.

  States are those of MISSION_CURRENT: `:none`, `:not_started`, `:active`, `:paused`, `:complete`.
  """

  import MavCodec.Command

  alias SimVehicle.{Plans, Real32, Vehicle}
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Flight.Goal

  @jumps_max 100

  defstruct current: 0, goal: nil, state: :none, jumps: %{}, speed: nil

  @type t :: %__MODULE__{}

  @doc "No mission."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "A mission that is interrupted by something else. ArduPilot then calls it not started."
  @spec stop(Vehicle.t()) :: t
  def stop(%{mission: %{state: :active} = mission} = v),
    do: %{mission | state: if(v.plans.style == :ardupilot, do: :not_started, else: :paused), goal: nil}

  def stop(%{mission: mission}), do: %{mission | goal: nil}

  # The number of the first item that is flown: ArduPilot's item 0 is home.
  defp first(v), do: if(v.plans.style == :ardupilot, do: 1, else: 0)

  @doc "True when there is something to fly."
  @spec any?(Vehicle.t()) :: boolean
  def any?(v), do: length(Plans.items(v.plans, 0)) > first(v)

  @doc "Starts at the current item, or from the beginning after the end was reached."
  @spec start(Vehicle.t()) :: Vehicle.t()
  def start(v) do
    current = if v.mission.state == :complete, do: first(v), else: max(v.mission.current, first(v))
    %{v | flight: :mission, mission: %{v.mission | current: current, goal: nil, state: :active}}
  end

  @doc "Makes `seq` the current item; false when there is none."
  @spec set_current(Vehicle.t(), integer) :: {boolean, Vehicle.t()}
  def set_current(v, seq) do
    if seq >= 0 and seq < length(Plans.items(v.plans, 0)) do
      state = if v.flight == :mission, do: :active, else: :not_started
      {true, %{v | mission: %{v.mission | current: seq, goal: nil, state: state}}}
    else
      {false, v}
    end
  end

  @doc "After a plan was replaced or cleared."
  @spec reset(Vehicle.t()) :: Vehicle.t()
  def reset(v) do
    state = if any?(v), do: :not_started, else: :none
    v = %{v | mission: %__MODULE__{state: state}}
    if v.flight == :mission, do: %{v | flight: Goal.hold(v.kin)}, else: v
  end

  @doc "Moves on: a setpoint, or `:again` when the vehicle does something else now."
  @spec advance(Vehicle.t()) :: {:cont, Vehicle.t(), term} | {:again, Vehicle.t()}
  def advance(%{mission: %{goal: nil}} = v), do: begin(v, @jumps_max)

  def advance(%{mission: %{goal: goal}} = v) do
    case Goal.advance(goal, v) do
      {:cont, goal, setpoint, events} ->
        v = %{v | mission: %{v.mission | goal: goal}}
        v = Enum.reduce(events, v, fn event, v -> v.personality.flight_event(v, event) end)
        if v.flight == :mission, do: {:cont, v, setpoint}, else: {:again, v}

      {:done, _event, _next} ->
        v |> reached() |> next()
    end
  end

  defp next(%{flight: :mission} = v),
    do: begin(%{v | mission: %{v.mission | goal: nil, current: v.mission.current + 1}}, @jumps_max)

  defp next(v), do: {:again, v}

  defp begin(v, 0), do: finish(v)

  defp begin(v, left) do
    seq = v.mission.current

    case Enum.at(Plans.items(v.plans, 0), seq) do
      nil ->
        finish(v)

      item ->
        v = v.personality.flight_event(v, {:item, item})
        if v.flight == :mission, do: start_item(v, item, left), else: {:again, v}
    end
  end

  defp start_item(v, item, left) do
    case goal(v, item) do
      {:goal, goal} -> advance(%{v | mission: %{v.mission | goal: goal}})
      {:vehicle, v} -> {:again, v}
      {:jump, seq, v} -> begin(%{v | mission: %{v.mission | current: seq}}, left - 1)
      {:pass, v} -> v |> reached(:action) |> pass(left)
    end
  end

  defp pass(%{flight: :mission} = v, left),
    do: begin(%{v | mission: %{v.mission | current: v.mission.current + 1}}, left - 1)

  defp pass(v, _left), do: {:again, v}

  defp reached(v, kind \\ :place) do
    seq = v.mission.current
    v.personality.flight_event(Vehicle.notify(v, {:reached, seq}), {:reached, kind, seq})
  end

  defp finish(v) do
    last = max(length(Plans.items(v.plans, 0)) - 1, 0)
    v = %{v | flight: Goal.hold(v.kin), mission: %{v.mission | state: :complete, goal: nil, current: last}}
    v = if v.airborne, do: v, else: %{v | flight: if(v.armed, do: :idle, else: :off)}
    {:again, v.personality.flight_event(v, :mission_done)}
  end

  # --- items ---

  # In the air PX4 flies to the place of the take-off item, ArduPilot only looks at its height.
  defp goal(%{airborne: true, plans: %{style: :px4}} = v, %{command: cmd(:NAV_TAKEOFF)} = item) do
    {n, e} = place(v, item)
    {:goal, goto(v, n, e, down(v, item))}
  end

  defp goal(v, %{command: cmd(:NAV_TAKEOFF)} = item) do
    from = if v.armed_at, do: max(v.now, v.armed_at + round(v.limits.spool * 1.0e6)), else: v.now
    {:goal, Goal.takeoff(v.kin, down(v, item), from)}
  end

  defp goal(v, %{command: command} = item)
       when command in cmds(~w(NAV_WAYPOINT NAV_SPLINE_WAYPOINT NAV_LOITER_TIME)a) do
    {n, e} = place(v, item)
    hold = Real32.number(elem(item.params, 0)) || 0.0
    flight = goto(v, n, e, down(v, item))

    if hold > 0,
      do: {:goal, Goal.steps([{:fly, flight}, {:stay, Goal.wait(n, e, down(v, item), round(hold * 1.0e6))}])},
      else: {:goal, flight}
  end

  defp goal(v, %{command: cmd(:NAV_LOITER_UNLIM)} = item) do
    {n, e} = place(v, item)

    {:goal,
     Goal.steps([{:fly, goto(v, n, e, down(v, item))}, {:stay, %{do: :hold, n: n, e: e, d: down(v, item)}}])}
  end

  defp goal(v, %{command: cmd(:NAV_LOITER_TURNS)} = item) do
    {n, e} = place(v, item)
    turns = Real32.number(elem(item.params, 0)) || 1.0
    {:goal, Goal.orbit(n, e, down(v, item), v.limits.orbit, v.limits.speed / 2, max(turns, 0.0))}
  end

  defp goal(v, %{command: cmd(:NAV_RETURN_TO_LAUNCH)}), do: v.personality.mission_rtl(v)

  defp goal(v, %{command: cmd(:NAV_LAND)} = item) do
    {n, e} = place(v, item)
    {:goal, Goal.steps([{:fly, goto(v, n, e, v.kin.d)}, {:land, Goal.land(n, e)}])}
  end

  defp goal(v, %{command: cmd(:NAV_DELAY)} = item) do
    seconds = max(Real32.number(elem(item.params, 0)) || 0.0, 0.0)
    {:goal, Goal.wait(v.kin.n, v.kin.e, v.kin.d, round(seconds * 1.0e6))}
  end

  defp goal(v, %{command: cmd(:DO_JUMP), params: {to, times, _p3, _p4}} = item) do
    done = Map.get(v.mission.jumps, item.seq, 0)
    {to, times} = {trunc(Real32.number(to) || 0), trunc(Real32.number(times) || 0)}

    if (times < 0 or done < times) and to >= 0 and to < length(Plans.items(v.plans, 0)),
      do: {:jump, to, %{v | mission: %{v.mission | jumps: Map.put(v.mission.jumps, item.seq, done + 1)}}},
      else: {:jump, v.mission.current + 1, v}
  end

  defp goal(v, %{command: cmd(:DO_CHANGE_SPEED), params: {_type, speed, _p3, _p4}}) do
    case Real32.number(speed) do
      speed when is_number(speed) and speed > 0 ->
        {:pass, %{v | mission: %{v.mission | speed: min(speed, 20.0)}}}

      _unchanged ->
        {:pass, v}
    end
  end

  defp goal(v, _action), do: {:pass, v}

  defp goto(v, n, e, d), do: Goal.goto(n, e, d, speed: v.mission.speed || v.limits.speed)

  # No position (0/0), or an impossible one, means here.
  defp place(v, %{x: 0, y: 0}), do: {v.kin.n, v.kin.e}
  defp place(v, %{x: x, y: y}) when abs(x) > 900_000_000 or abs(y) > 1_800_000_000, do: {v.kin.n, v.kin.e}
  defp place(v, item), do: Geo.to_local(v.origin, item.x, item.y)

  # The height of an item as metres down of the origin; altitudes are above home or above the sea.
  defp down(v, %{frame: frame, z: z}) when frame in [0, 5], do: v.origin.alt - z
  defp down(v, %{z: z}), do: v.origin.alt - ((v.home || v.origin).alt + z)
end
