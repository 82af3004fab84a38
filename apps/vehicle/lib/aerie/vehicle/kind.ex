defmodule Aerie.Vehicle.Kind do
  @moduledoc """
  The kind of a vehicle, by MAV_TYPE and MAV_AUTOPILOT of its autopilot's heartbeat, never by the component id (R10).
  """

  @kinds %{
    "plane" => [1],
    "copter" => [2, 3, 4, 13, 14, 15, 29, 35, 43],
    "tracker" => [5],
    "blimp" => [7],
    "balloon" => [8],
    "rocket" => [9],
    "rover" => [10],
    "boat" => [11],
    "sub" => [12],
    "flapping_wing" => [16],
    "kite" => [17],
    "vtol" => [19, 20, 21, 22, 23, 24, 25],
    "parafoil" => [28],
    "spacecraft" => [45]
  }
  @by_type for {kind, types} <- @kinds, type <- types, into: %{}, do: {type, kind}

  # Types that are no vehicles: ground stations, on-board computers, gimbals, ADS-B receivers, cameras, chargers, FLARMs,
  # servos, remote id, batteries, parachutes, logs, OSDs, sensors, winches, lights.
  @not_vehicles [6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 37, 38, 39, 40, 41, 42, 44]

  @autopilot_invalid 8

  @type autopilot :: :ardupilot | :px4 | :generic

  @doc "The kind of vehicle of a MAV_TYPE; `\"unknown\"` for a generic or unknown one."
  @spec name(integer()) :: String.t()
  def name(type), do: Map.get(@by_type, type, "unknown")

  @doc "The firmware family of a MAV_AUTOPILOT."
  @spec autopilot(integer()) :: autopilot()
  def autopilot(3), do: :ardupilot
  def autopilot(12), do: :px4
  def autopilot(_other), do: :generic

  @doc """
  Whether a heartbeat with this MAV_TYPE and MAV_AUTOPILOT is that of a vehicle's autopilot (H2).

  Everything else should send MAV_AUTOPILOT_INVALID; some ground stations and cameras do not, so the type counts, too.
  """
  @spec vehicle?(integer(), integer()) :: boolean()
  def vehicle?(_type, @autopilot_invalid), do: false
  def vehicle?(type, _autopilot), do: type not in @not_vehicles

  @doc "Whether this kind of vehicle takes off and lands."
  @spec flies?(String.t()) :: boolean()
  def flies?(kind), do: kind not in ["rover", "boat", "sub", "tracker", "spacecraft"]
end
