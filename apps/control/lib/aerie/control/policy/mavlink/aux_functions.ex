defmodule Aerie.Control.Policy.Mavlink.AuxFunctions do
  @moduledoc """
  What the functions of ArduPilot's switches do (RCn_OPTION), which DO_AUX_FUNCTION, a mission and an override may work
  as well as a pilot. A function that is not here needs the most, because nobody here knows what it does.
  """

  alias Aerie.Control.Policy.Intent

  @high 2

  # Their high position changes to the mode; the others go back to that of the pilot's switch, which may be any.
  @modes %{
    2 => "FLIP",
    4 => "RTL",
    16 => "AUTO",
    17 => "AUTOTUNE",
    18 => "LAND",
    33 => "BRAKE",
    37 => "THROW",
    42 => "SMART_RTL",
    51 => "MANUAL",
    52 => "ACRO",
    53 => "STEERING",
    54 => "HOLD",
    55 => "GUIDED",
    56 => "LOITER",
    57 => "FOLLOW",
    59 => "SIMPLE",
    60 => "ZIGZAG",
    68 => "STABILIZE",
    69 => "POSHOLD",
    70 => "ALT_HOLD",
    71 => "FLOWHOLD",
    72 => "CIRCLE",
    73 => "DRIFT",
    77 => "TAKEOFF",
    92 => "FBWA",
    98 => "TRAINING",
    99 => "AUTO_RTL",
    108 => "QRTL",
    150 => "CRUISE",
    151 => "TURTLE",
    170 => "QSTABILIZE",
    183 => "AUTOLAND",
    184 => "SYSTEMID"
  }

  # Motors: emergency stop, interlock, arming by a switch, disarming, the engine. Not in their high position they stop
  # them,
  # in flight as well.
  @motors [32, 41, 153, 154, 165, 179]
  @stops [31, 81]
  @parachute [21, 22, 23]
  # Fence and avoidance: on in the high position only.
  @guards [11, 38, 40]
  # Sensors that fail, checks for a crash, an emergency landing, the mode of the switch; terrain that is not followed
  # any more, thermals that are.
  @failures [65, 86, 88, 100, 101, 105, 106, 110, 157, 159]
  # The throttle is idle while it lasts.
  @flare 89
  @payload [
             9,
             15,
             19,
             27,
             28,
             30,
             34,
             35,
             36,
             44,
             45,
             66,
             67,
             78,
             79,
             94,
             102,
             113,
             163,
             166,
             167,
             168,
             169,
             174,
             175,
             177
           ] ++
             Enum.to_list(212..217)
  @mission [7, 24, 58, 61]
  @fly [3, 13, 29, 39, 63, 83, 87, 95, 152, 160, 173, 178]
  # Sticks that an option puts on a channel.
  @manual [201, 202, 203, 204, 207, 208, 209, 210, 211]
  @nothing 0
  # Trims, calibrations, controllers, sources of estimates, scripts, other functions of a workshop.
  @maintain [
              5,
              10,
              12,
              14,
              25,
              26,
              43,
              46,
              47,
              48,
              49,
              50,
              62,
              64,
              74,
              75,
              76,
              80,
              82,
              84,
              85,
              90,
              91,
              96,
              97,
              103,
              104,
              107,
              109,
              111,
              112,
              155,
              156,
              158,
              161,
              162,
              164,
              171,
              172,
              176,
              180,
              181,
              182,
              218,
              219,
              220
            ] ++ Enum.to_list(300..315)

  @doc "The facts of a function and the position of its switch; nil for what is not an integer."
  @spec facts(integer() | nil, integer() | nil) :: Intent.t()
  def facts(function, @high) when is_map_key(@modes, function),
    do: Intent.named("set_mode", mode: Map.fetch!(@modes, function))

  def facts(function, _low) when is_map_key(@modes, function),
    do: Intent.named("set_mode", mode: "MODE(switch)")

  def facts(function, _position) when function in @stops, do: Intent.named("force_disarm")
  def facts(function, @high) when function in @motors, do: Intent.named("arm")
  def facts(function, _low) when function in @motors, do: Intent.named("force_disarm")
  def facts(22, @high), do: Intent.named("parachute", ends_flight?: true)

  def facts(function, _position) when function in @parachute,
    do: Intent.named("parachute", ends_flight?: false)

  def facts(11, @high), do: Intent.named("set_geofence")
  def facts(function, @high) when function in @guards, do: own(:fly)
  def facts(function, _low) when function in @guards, do: own(:protection)
  def facts(function, _position) when function in @failures, do: own(:protection)
  def facts(function, _position) when function in @payload, do: own(:payload)
  def facts(function, _position) when function in @mission, do: own(:mission)
  def facts(function, _position) when function in @fly, do: own(:fly)
  def facts(@flare, @high), do: own(:fly, [:force_disarm])
  def facts(@flare, _low), do: own(:fly)
  def facts(@nothing, _position), do: own(:payload)
  def facts(function, _position) when function in @manual, do: own(:manual)
  def facts(function, _position) when function in @maintain, do: own(:maintain)

  def facts(_unlisted, _position) do
    [first | more] = Intent.most()
    own(first, more)
  end

  defp own(permission, also \\ []),
    do: %Intent{
      type: "aux_function",
      permission: permission,
      also: also,
      moves?: permission in [:fly, :mission]
    }
end
