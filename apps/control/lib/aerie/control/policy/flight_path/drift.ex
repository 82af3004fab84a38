defmodule Aerie.Control.Policy.FlightPath.Drift do
  @moduledoc """
  How far a velocity leads until the vehicle stands again. It is flown for as long as the gateway repeats it, then until
  the vehicle's own time-out for set-points that stop (`Aerie.Vehicle.Firmware.Reading`), then for a second of reaction;
  from there the vehicle brakes. An acceleration goes on all that time.
  """

  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware

  # Age of the position, way of the message, and the lag of the vehicle's controllers.
  @reaction_s 1.0
  # Braking in m/s², less than both firmwares' defaults (WPNAV_ACCEL and WPNAV_ACCEL_Z, MPC_ACC_HOR and MPC_ACC_DOWN_MAX).
  @brake_xy 1.5
  @brake_z 1.0
  @longest_s 60
  @turns 36
  # Farther than any fence reaches.
  @far_m 1_000_000

  @typedoc "So many metres north, east and down."
  @type offset :: {number(), number(), number()}

  @doc """
  Where it leads, each way as its corners in metres from where it begins; of a velocity whose direction is not certain there are many ways.
  An error says what would have to be known.
  """
  @spec ways(Intent.drift(), Context.t()) :: {:ok, [[offset(), ...], ...]} | {:unknown, String.t()}
  def ways(drift, context) do
    with {:ok, turns} <- turns(drift.frame, context) do
      corners = corners(drift, seconds(drift, context))

      if Enum.all?(corners, fn {x, y, z} -> abs(x) < @far_m and abs(y) < @far_m and abs(z) < @far_m end),
        do: {:ok, for(turn <- turns, do: Enum.map(corners, &turned(&1, turn)))},
        else: {:unknown, Refusal.text(:too_far)}
    end
  end

  # For how long it is flown before the vehicle brakes.
  defp seconds(drift, context), do: drift.hold + timeout(context) + @reaction_s

  defp timeout(context) do
    {name, default} = Firmware.reading(context.autopilot).setpoint_timeout

    case context.params[name] do
      known when is_number(known) and known >= 0 -> min(known / 1, @longest_s)
      _unknown -> default
    end
  end

  # Where it begins to brake, and where it stands.
  defp corners(%{velocity: {vx, vy, vz}, acceleration: {ax, ay, az}}, t) do
    {ux, uy, uz} = {vx + ax * t, vy + ay * t, vz + az * t}
    {x, y, z} = {(vx + ux) / 2 * t, (vy + uy) / 2 * t, (vz + uz) / 2 * t}
    speed = :math.sqrt(ux * ux + uy * uy)
    brake = speed / (2 * @brake_xy)
    [{x, y, z}, {x + ux * brake, y + uy * brake, z + uz * abs(uz) / (2 * @brake_z)}]
  end

  defp turns(:north, _context), do: {:ok, [0.0]}
  defp turns(:any, _context), do: {:ok, for(n <- 0..(@turns - 1), do: n * 2 * :math.pi() / @turns)}
  defp turns(:body, %{position: %{heading: nil}}), do: {:unknown, Refusal.text(:heading)}
  defp turns(:body, %{position: %{heading: heading}}), do: {:ok, [heading * :math.pi() / 180]}

  @doc "An offset ahead and to the right, turned to the north and the east."
  @spec turned(offset(), angle :: float()) :: offset()
  def turned(offset, +0.0), do: offset

  def turned({ahead, right, down}, angle) do
    {sin, cos} = {:math.sin(angle), :math.cos(angle)}
    {ahead * cos - right * sin, ahead * sin + right * cos, down}
  end
end
