defmodule SimVehicle.Physics.Kinematics do
  @moduledoc """
  Motion of a multicopter as a pure function of a setpoint and time.

  Position is in metres north, east and down of the take-off point; the ground is the plane `d = 0`. Velocity is in
  m/s, angles in radians, angular rates in rad/s. Speed and acceleration are limited; attitude follows from the
  acceleration that the motion needs, so that telemetry is consistent in itself. It is not a flight-dynamics model.
  """

  alias SimVehicle.Physics.Geo

  @gravity 9.80665
  @accel_z 2.0
  @position_gain 1.0
  @yaw_rate_max 1.05
  @attitude_lag 0.25

  defstruct n: 0.0,
            e: 0.0,
            d: 0.0,
            vn: 0.0,
            ve: 0.0,
            vd: 0.0,
            an: 0.0,
            ae: 0.0,
            ad: 0.0,
            roll: 0.0,
            pitch: 0.0,
            yaw: 0.0,
            rollspeed: 0.0,
            pitchspeed: 0.0,
            yawspeed: 0.0,
            throttle: 0.0,
            impact: nil

  @typedoc """
  - `impact`: speed in m/s at which the vehicle met the ground in the last step, else nil
  - `throttle`: 0.0..1.0
  """
  @type t :: %__MODULE__{}

  @typedoc """
  What the motion should become. `:off` = motors stopped (falls when in the air), `:idle` = motors turn, no lift.
  Otherwise a map:

  - `xy`: `{:pos, n, e}` or `{:vel, vn, ve}`
  - `z`: `{:pos, d}` or `{:vel, vd}` (down is positive)
  - `yaw`: `:keep`, `{:to, radians}` or `{:rate, rad/s}`
  - `speed`, `up`, `down`: limits in m/s; `accel`: limit of horizontal acceleration in m/s²
  """
  @type setpoint :: :off | :idle | map

  @doc "One step of `dt` seconds (0..0.2) towards `setpoint`, disturbed by `{wind_n, wind_e}` in m/s."
  @spec step(t, setpoint, float, {float, float}) :: t
  def step(kin, setpoint, dt, wind \\ {0.0, 0.0})

  def step(kin, still, _dt, _wind) when still in [:off, :idle] and kin.d >= 0.0 do
    throttle = if still == :idle, do: 0.1, else: 0.0

    %{
      kin
      | vn: 0.0,
        ve: 0.0,
        vd: 0.0,
        an: 0.0,
        ae: 0.0,
        ad: 0.0,
        rollspeed: 0.0,
        pitchspeed: 0.0,
        yawspeed: 0.0,
        roll: 0.0,
        pitch: 0.0,
        d: 0.0,
        throttle: throttle,
        impact: nil
    }
  end

  def step(kin, still, dt, _wind) when still in [:off, :idle] do
    vd = min(kin.vd + @gravity * dt, 40.0)
    drag = 1 - min(0.1 * dt, 1.0)

    %{kin | vd: vd, vn: kin.vn * drag, ve: kin.ve * drag, ad: @gravity, throttle: 0.0}
    |> integrate(dt, {0.0, 0.0})
    |> ground()
  end

  def step(kin, setpoint, dt, wind) do
    {want_n, want_e} = want_xy(kin, setpoint)
    {vn, ve} = limit_change({kin.vn, kin.ve}, {want_n, want_e}, setpoint.accel * dt)
    vd = approach(kin.vd, want_z(kin, setpoint), @accel_z * dt)

    %{kin | an: (vn - kin.vn) / dt, ae: (ve - kin.ve) / dt, ad: (vd - kin.vd) / dt}
    |> Map.merge(%{vn: vn, ve: ve, vd: vd})
    |> integrate(dt, wind)
    |> attitude(setpoint.yaw, dt)
    |> ground()
  end

  @doc "Speed over ground in m/s."
  @spec groundspeed(t) :: float
  def groundspeed(kin), do: :math.sqrt(kin.vn * kin.vn + kin.ve * kin.ve)

  @doc "Horizontal distance in metres from the vehicle to a point."
  @spec distance(t, number, number) :: float
  def distance(kin, n, e), do: :math.sqrt((n - kin.n) ** 2 + (e - kin.e) ** 2)

  # The square-root law is the speed from which the acceleration limit can still stop in the distance that is left.
  defp want_xy(kin, %{xy: {:pos, n, e}, speed: limit, accel: accel}) do
    dist = distance(kin, n, e)
    speed = Enum.min([limit, @position_gain * dist, :math.sqrt(accel * dist)])
    if dist < 1.0e-6, do: {0.0, 0.0}, else: {(n - kin.n) / dist * speed, (e - kin.e) / dist * speed}
  end

  defp want_xy(_kin, %{xy: {:vel, vn, ve}, speed: limit}) do
    speed = :math.sqrt(vn * vn + ve * ve)
    if speed > limit, do: {vn / speed * limit, ve / speed * limit}, else: {vn, ve}
  end

  defp want_z(kin, %{z: {:pos, d}} = setpoint) do
    error = d - kin.d
    speed = min(@position_gain * abs(error), :math.sqrt(@accel_z * abs(error)))
    if error > 0, do: min(speed, setpoint.down), else: -min(speed, setpoint.up)
  end

  defp want_z(_kin, %{z: {:vel, vd}} = setpoint), do: vd |> max(-setpoint.up) |> min(setpoint.down)

  defp limit_change({from_n, from_e}, {to_n, to_e}, most) do
    {dn, de} = {to_n - from_n, to_e - from_e}
    size = :math.sqrt(dn * dn + de * de)
    if size <= most, do: {to_n, to_e}, else: {from_n + dn / size * most, from_e + de / size * most}
  end

  defp approach(from, to, most), do: from + max(-most, min(most, to - from))

  defp integrate(kin, dt, {wind_n, wind_e}) do
    %{
      kin
      | n: kin.n + (kin.vn + wind_n) * dt,
        e: kin.e + (kin.ve + wind_e) * dt,
        d: kin.d + kin.vd * dt
    }
  end

  defp attitude(kin, yaw_setpoint, dt) do
    {cos, sin} = {:math.cos(kin.yaw), :math.sin(kin.yaw)}
    lift = @gravity - kin.ad
    roll = :math.atan((kin.ae * cos - kin.an * sin) / lift)
    pitch = -:math.atan((kin.an * cos + kin.ae * sin) / lift)
    blend = min(dt / @attitude_lag, 1.0)
    {roll, pitch} = {kin.roll + (roll - kin.roll) * blend, kin.pitch + (pitch - kin.pitch) * blend}
    yawspeed = approach(kin.yawspeed, want_yaw_rate(kin.yaw, yaw_setpoint), 3.0 * dt)

    %{
      kin
      | rollspeed: (roll - kin.roll) / dt,
        pitchspeed: (pitch - kin.pitch) / dt,
        yawspeed: yawspeed,
        roll: roll,
        pitch: pitch,
        yaw: Geo.wrap_pi(kin.yaw + yawspeed * dt),
        throttle: (0.36 * lift / @gravity) |> max(0.0) |> min(1.0)
    }
  end

  defp want_yaw_rate(_yaw, :keep), do: 0.0
  defp want_yaw_rate(_yaw, {:rate, rate}), do: rate |> max(-@yaw_rate_max) |> min(@yaw_rate_max)

  defp want_yaw_rate(yaw, {:to, target}) do
    want_yaw_rate(yaw, {:rate, 1.5 * Geo.wrap_pi(target - yaw)})
  end

  defp ground(%{d: d} = kin) when d >= 0.0 and kin.vd >= 0.0 do
    impact = if kin.vd > 0.0, do: kin.vd, else: nil
    %{kin | d: 0.0, vd: 0.0, vn: 0.0, ve: 0.0, roll: 0.0, pitch: 0.0, yawspeed: 0.0, impact: impact}
  end

  defp ground(kin), do: %{kin | impact: nil}
end
