defmodule MavCodec.Meaning.Pilot do
  @moduledoc """
  The parameters that a pilot sets before and during a flight: heights and speeds, each within bounds that any vehicle
  of its kind can fly. The permission `pilot` is enough to set them; every other parameter, and a value beyond its
  bounds, needs `maintain`. Speeds at which a wing stalls are not among them.
  """

  # Name, least and most in the parameter's own unit, and what it is.
  @rows [
    {"RTL_ALT", 500, 12_000, "cm", "the height of the way home"},
    {"RTL_ALT_M", 5, 120, "m", "the height of the way home"},
    {"RTL_ALTITUDE", 20, 120, "m", "the height of the way home"},
    {"ALT_HOLD_RTL", 2_000, 12_000, "cm", "the height of the way home"},
    {"RTL_RETURN_ALT", 5, 120, "m", "the height of the way home"},
    {"RTL_DESCEND_ALT", 5, 100, "m", "the height above home at the end of the way"},
    {"PILOT_TKOFF_ALT", 100, 3_000, "cm", "the height of a take-off"},
    {"MIS_TAKEOFF_ALT", 2, 50, "m", "the height of a take-off"},
    {"WPNAV_SPEED", 50, 2_000, "cm/s", "speed along a mission"},
    {"WPNAV_SPEED_UP", 50, 500, "cm/s", "speed of a climb"},
    {"WPNAV_SPEED_DN", 50, 300, "cm/s", "speed of a descent"},
    {"WP_SPD", 0.5, 20, "m/s", "speed along a mission"},
    {"WP_SPD_UP", 0.5, 5, "m/s", "speed of a climb"},
    {"WP_SPD_DN", 0.5, 3, "m/s", "speed of a descent"},
    {"LOIT_SPEED", 100, 2_000, "cm/s", "speed of a pilot's sticks"},
    {"LOIT_SPEED_MS", 1, 20, "m/s", "speed of a pilot's sticks"},
    {"RTL_SPEED", 100, 2_000, "cm/s", "speed of the way home"},
    {"RTL_SPEED_MS", 1, 20, "m/s", "speed of the way home"},
    {"LAND_SPEED", 30, 100, "cm/s", "speed of a landing near the ground"},
    {"LAND_SPD_MS", 0.3, 1, "m/s", "speed of a landing near the ground"},
    {"LAND_SPEED_HIGH", 30, 300, "cm/s", "speed of a landing"},
    {"LAND_SPD_HIGH_MS", 0.3, 3, "m/s", "speed of a landing"},
    {"PILOT_SPEED_UP", 50, 500, "cm/s", "speed of a climb by the sticks"},
    {"PILOT_SPEED_DN", 50, 300, "cm/s", "speed of a descent by the sticks"},
    {"MPC_XY_CRUISE", 1, 20, "m/s", "speed along a mission"},
    {"MPC_XY_VEL_MAX", 1, 20, "m/s", "the highest speed"},
    {"MPC_VEL_MANUAL", 1, 20, "m/s", "speed of a pilot's sticks"},
    {"MPC_Z_V_AUTO_UP", 0.5, 5, "m/s", "speed of a climb"},
    {"MPC_Z_V_AUTO_DN", 0.5, 3, "m/s", "speed of a descent"},
    {"MPC_Z_VEL_MAX_UP", 0.5, 5, "m/s", "the highest speed of a climb"},
    {"MPC_Z_VEL_MAX_DN", 0.5, 3, "m/s", "the highest speed of a descent"},
    {"MPC_LAND_SPEED", 0.3, 1, "m/s", "speed of a landing near the ground"}
  ]
  @bounds Map.new(@rows, fn {name, least, most, _unit, _meaning} -> {name, {least, most}} end)

  @typedoc "Name, least, most, unit, meaning."
  @type row :: {String.t(), number(), number(), String.t(), String.t()}

  @doc "All rows, in their order."
  @spec all() :: [row(), ...]
  def all, do: @rows

  @doc "Whether a pilot sets a parameter to this value; nil is one that is not known."
  @spec within?(String.t() | nil, number() | nil) :: boolean()
  def within?(name, value) when is_number(value) do
    case @bounds do
      %{^name => {least, most}} -> value >= least and value <= most
      _another -> false
    end
  end

  def within?(_name, _unknown), do: false
end
