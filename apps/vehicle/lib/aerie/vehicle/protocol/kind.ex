defmodule Aerie.Vehicle.Protocol.Kind do
  @moduledoc """
  The kind of a vehicle, by MAV_TYPE of its autopilot's heartbeat, never by the component id (R10).
  ArduPlane with rotors says FIXED_WING there by default: `Aerie.Vehicle.State.Groups.Mode` tells it from its other
  signs.
  """

  alias MavCodec.Enums.MavType

  @kinds %{
    "plane" => ~w(FIXED_WING),
    "copter" =>
      ~w(QUADROTOR COAXIAL HELICOPTER HEXAROTOR OCTOROTOR TRICOPTER DODECAROTOR DECAROTOR GENERIC_MULTIROTOR),
    "tracker" => ~w(ANTENNA_TRACKER),
    "blimp" => ~w(AIRSHIP),
    "balloon" => ~w(FREE_BALLOON),
    "rocket" => ~w(ROCKET),
    "rover" => ~w(GROUND_ROVER),
    "boat" => ~w(SURFACE_BOAT),
    "sub" => ~w(SUBMARINE),
    "flapping_wing" => ~w(FLAPPING_WING),
    "kite" => ~w(KITE),
    "vtol" =>
      ~w(VTOL_TAILSITTER_DUOROTOR VTOL_TAILSITTER_QUADROTOR VTOL_TILTROTOR VTOL_FIXEDROTOR VTOL_TAILSITTER
      VTOL_TILTWING VTOL_RESERVED5),
    "parafoil" => ~w(PARAFOIL),
    "spacecraft" => ~w(SPACECRAFT_ORBITER)
  }
  @by_type for {kind, names} <- @kinds,
               name <- names,
               into: %{},
               do: {MavType.value(:"MAV_TYPE_#{name}"), kind}

  @doc "The kind of vehicle of a MAV_TYPE; `\"unknown\"` for a generic or unknown one."
  @spec name(integer()) :: String.t()
  def name(type), do: Map.get(@by_type, type, "unknown")

  @doc "Whether this kind of vehicle takes off and lands."
  @spec flies?(String.t()) :: boolean()
  def flies?(kind), do: kind not in ["rover", "boat", "sub", "tracker", "spacecraft"]
end
