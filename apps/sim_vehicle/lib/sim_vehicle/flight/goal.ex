defmodule SimVehicle.Flight.Goal do
  @moduledoc """
  What a vehicle can be doing, and the motion that each asks for.

  `:off` motors stopped, `:idle` motors turn on the ground, else a map with `do:` one of `:hold`, `:takeoff`, `:goto`,
  `:velocity`, `:moving`, `:axes`, `:orbit`, `:land`, `:sink`, `:settle`, `:wait` or `:steps` (several in a row). Heights are `d`, metres
  down of the origin. A goal ends by returning an event and what to do next.
  """

  alias SimVehicle.Physics.Kinematics

  @type t :: :off | :idle | map

  @doc "Keep this place and height."
  @spec hold(map) :: t
  def hold(%{n: n, e: e, d: d}), do: %{do: :hold, n: n, e: e, d: d}

  @doc "Wait for the motors until vehicle time `from`, then climb to `d` above the place of the vehicle."
  @spec takeoff(map, float, integer) :: t
  def takeoff(kin, d, from), do: %{do: :takeoff, n: kin.n, e: kin.e, d: d, from: from}

  @doc "Fly to a point; options `:yaw` (radians, default along the way), `:speed` (m/s), `:radius` (m)."
  @spec goto(float, float, float, keyword) :: t
  def goto(n, e, d, opts \\ []), do: Map.merge(%{do: :goto, n: n, e: e, d: d, yaw: nil}, Map.new(opts))

  @doc "Keep a velocity (m/s north, east, down), to which an acceleration adds since a time, until vehicle time `until`, then hold."
  @spec velocity({float, float, float}, term, integer, {{float, float, float}, since :: integer}) :: t
  def velocity({vn, ve, vd}, yaw, until, added),
    do: %{do: :velocity, vn: vn, ve: ve, vd: vd, yaw: yaw, until: until, added: added}

  @doc "Fly to a place that moves with a velocity until vehicle time `until`."
  @spec moving({float, float, float}, {float, float, float}, term, since :: integer, until :: integer) :: t
  def moving(place, velocity, yaw, since, until),
    do: %{do: :moving, place: place, velocity: velocity, yaw: yaw, since: since, until: until}

  @doc "By axis: a place, a velocity or an acceleration, horizontally and vertically, until vehicle time `until`, then hold."
  @spec axes(tuple, tuple, term, integer) :: t
  def axes(xy, z, yaw, until), do: %{do: :axes, xy: xy, z: z, yaw: yaw, until: until}

  @doc "Circle around a point, looking at it; `turns` nil = for ever."
  @spec orbit(float, float, float, float, float, float | nil) :: t
  def orbit(n, e, d, radius, speed, turns \\ nil),
    do: %{do: :orbit, n: n, e: e, d: d, radius: radius, speed: speed, turns: turns, swept: 0.0, angle: nil}

  @doc "Land at a point."
  @spec land(float, float) :: t
  def land(n, e), do: %{do: :land, n: n, e: e}

  @doc "Go down at `speed` m/s without holding the place: no throttle, or no position."
  @spec sink(float) :: t
  def sink(speed), do: %{do: :sink, speed: speed}

  @doc "On the ground until the landing is certain."
  @spec settle(integer) :: t
  def settle(until), do: %{do: :settle, until: until}

  @doc "Hold a point for `us` microseconds."
  @spec wait(float, float, float, non_neg_integer) :: t
  def wait(n, e, d, us), do: %{do: :wait, n: n, e: e, d: d, us: us, until: nil}

  @doc "Goals one after the other, each with a tag that is announced when it begins."
  @spec steps([{atom, t}]) :: t
  def steps(steps), do: %{do: :steps, steps: steps, told: false}

  @doc "The motion that keeps a vehicle as it is."
  @spec standing(map) :: Kinematics.setpoint()
  def standing(%{airborne: true, armed: true} = v),
    do: setpoint(v, {:pos, v.kin.n, v.kin.e}, {:pos, v.kin.d}, :keep)

  def standing(%{armed: true}), do: :idle
  def standing(_v), do: :off

  @doc """
  One look at a goal: `{:cont, goal, setpoint, events}` while it lasts, `{:done, event, next_goal}` at its end.
  """
  @spec advance(t, map) :: {:cont, t, Kinematics.setpoint(), [term]} | {:done, term, t}
  def advance(:off, _v), do: {:cont, :off, :off, []}
  def advance(:idle, _v), do: {:cont, :idle, :idle, []}

  def advance(%{do: :hold} = g, v), do: {:cont, g, setpoint(v, {:pos, g.n, g.e}, {:pos, g.d}, nose(g)), []}
  def advance(%{do: :settle} = g, _v), do: {:cont, g, :idle, []}

  def advance(%{do: :takeoff, from: from} = g, v) when v.now < from, do: {:cont, g, :idle, []}

  def advance(%{do: :takeoff} = g, v) do
    if abs(v.kin.d - g.d) < 0.3 or v.kin.d < g.d,
      do: {:done, :takeoff_done, hold(%{n: g.n, e: g.e, d: g.d})},
      else: {:cont, g, %{setpoint(v, {:pos, g.n, g.e}, {:pos, g.d}, :keep) | up: v.limits.takeoff}, []}
  end

  def advance(%{do: :goto} = g, v) do
    away = Kinematics.distance(v.kin, g.n, g.e)
    radius = Map.get(g, :radius, v.limits.radius)

    if away < radius and abs(v.kin.d - g.d) < 0.5 do
      # The nose may have further to turn.
      {:done, :arrived, Map.put(hold(g), :yaw, g.yaw)}
    else
      setpoint = setpoint(v, {:pos, g.n, g.e}, {:pos, g.d}, course(g, v, away))
      {:cont, g, %{setpoint | speed: Map.get(g, :speed, v.limits.speed)}, []}
    end
  end

  def advance(%{do: what, until: until}, v) when what in [:velocity, :axes] and v.now >= until,
    do: {:done, :velocity_timeout, hold(v.kin)}

  def advance(%{do: :velocity, added: {{an, ae, ad}, since}} = g, v) do
    s = (v.now - since) / 1.0e6
    {:cont, g, setpoint(v, {:vel, g.vn + an * s, g.ve + ae * s}, {:vel, g.vd + ad * s}, g.yaw), []}
  end

  def advance(%{do: :moving, place: {n, e, d}, velocity: {vn, ve, vd}} = g, v) do
    s = (min(v.now, g.until) - g.since) / 1.0e6
    {:cont, g, setpoint(v, {:pos, n + vn * s, e + ve * s}, {:pos, d + vd * s}, g.yaw), []}
  end

  # An acceleration is the velocity that it leads to within a second.
  def advance(%{do: :axes} = g, v) do
    xy = with {:acc, an, ae} <- g.xy, do: {:vel, v.kin.vn + an, v.kin.ve + ae}
    z = with {:acc, ad} <- g.z, do: {:vel, v.kin.vd + ad}
    {:cont, g, setpoint(v, xy, z, g.yaw), []}
  end

  def advance(%{do: :orbit, turns: turns, swept: swept} = g, _v)
      when turns != nil and swept >= turns * 6.2832,
      do: {:done, :arrived, hold(%{g | n: g.n, e: g.e})}

  def advance(%{do: :orbit} = g, v), do: orbiting(g, v)

  def advance(%{do: :land} = g, v) do
    height = -v.kin.d
    down = if height > v.limits.land_slow_below, do: v.limits.land_fast, else: v.limits.land_slow
    {:cont, g, %{setpoint(v, {:pos, g.n, g.e}, {:vel, down}, :keep) | down: down}, []}
  end

  def advance(%{do: :sink} = g, v),
    do: {:cont, g, %{setpoint(v, {:vel, 0.0, 0.0}, {:vel, g.speed}, :keep) | down: g.speed}, []}

  def advance(%{do: :wait, until: nil} = g, v), do: advance(%{g | until: v.now + g.us}, v)
  def advance(%{do: :wait, until: until} = g, v) when v.now >= until, do: {:done, :arrived, hold(g)}

  def advance(%{do: :wait} = g, v), do: {:cont, g, setpoint(v, {:pos, g.n, g.e}, {:pos, g.d}, nose(g)), []}

  def advance(%{do: :steps, steps: [{tag, _goal} | _rest], told: false} = g, v) do
    with {:cont, g, setpoint, events} <- advance(%{g | told: true}, v),
         do: {:cont, g, setpoint, [{:phase, tag} | events]}
  end

  def advance(%{do: :steps, steps: [{tag, goal} | rest]} = g, v) do
    case advance(goal, v) do
      {:cont, goal, setpoint, events} -> {:cont, %{g | steps: [{tag, goal} | rest]}, setpoint, events}
      {:done, event, next} when rest == [] -> {:done, event, next}
      {:done, _event, _next} -> advance(%{g | steps: rest, told: false}, v)
    end
  end

  defp orbiting(g, v) do
    bearing = :math.atan2(v.kin.e - g.e, v.kin.n - g.n)
    swept = if g.angle, do: g.swept + abs(SimVehicle.Physics.Geo.wrap_pi(bearing - g.angle)), else: 0.0
    # Aim a little ahead on the circle; the pull towards it grows with the distance from it.
    ahead = bearing + g.speed / max(g.radius, 1.0)
    {n, e} = {g.n + g.radius * :math.cos(ahead), g.e + g.radius * :math.sin(ahead)}
    inward = SimVehicle.Physics.Geo.wrap_pi(bearing + :math.pi())
    setpoint = setpoint(v, {:pos, n, e}, {:pos, g.d}, {:to, inward})
    {:cont, %{g | swept: swept, angle: bearing}, %{setpoint | speed: g.speed}, []}
  end

  defp nose(g), do: if(yaw = Map.get(g, :yaw), do: {:to, yaw}, else: :keep)

  defp course(%{yaw: yaw}, _v, _away) when is_number(yaw), do: {:to, yaw}
  defp course(_g, _v, away) when away < 3.0, do: :keep
  defp course(g, v, _away), do: {:to, :math.atan2(g.e - v.kin.e, g.n - v.kin.n)}

  defp setpoint(v, xy, z, yaw) do
    %{
      xy: xy,
      z: z,
      yaw: yaw,
      speed: v.limits.speed,
      accel: v.limits.accel,
      up: v.limits.up,
      down: v.limits.down
    }
  end
end
