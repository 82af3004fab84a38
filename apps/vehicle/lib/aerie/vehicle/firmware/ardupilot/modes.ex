defmodule Aerie.Vehicle.Firmware.Ardupilot.Modes do
  @moduledoc """
  ArduPilot's mode numbers by firmware: the enums of its MAVLink definitions (`COPTER_MODE`, …), the modes that those
  lack, and the names that its own ground stations use.
  """

  alias MavCodec.Enums

  @known_as %{
    "FLY_BY_WIRE_A" => "FBWA",
    "FLY_BY_WIRE_B" => "FBWB",
    "INITIALIZING" => "INITIALISING",
    "MOTORDETECT" => "MOTOR_DETECT"
  }

  table = fn enum, more ->
    for {_name, number} <- enum.all(), label = enum.label(number), into: more do
      {number, Map.get(@known_as, label, label)}
    end
  end

  @copter table.(Enums.CopterMode, %{29 => "RATE_ACRO"})
  @plane table.(Enums.PlaneMode, %{})
  @rover table.(Enums.RoverMode, %{2 => "LEARNING"})
  @sub table.(Enums.SubMode, %{})
  @tracker table.(Enums.TrackerMode, %{})
  # The definitions have no enum for these.
  @blimp %{0 => "LAND", 1 => "MANUAL", 2 => "VELOCITY", 3 => "LOITER", 4 => "RTL", 5 => "AUTO", 6 => "HOLD"}

  @standard %{
    "position_hold" => %{
      "copter" => "LOITER",
      "vtol" => "QLOITER",
      "sub" => "POSHOLD",
      "rover" => "HOLD",
      "boat" => "LOITER"
    },
    "orbit" => %{"copter" => "CIRCLE", "plane" => "CIRCLE", "vtol" => "CIRCLE"},
    "cruise" => %{"plane" => "CRUISE", "vtol" => "CRUISE"},
    "altitude_hold" => %{"copter" => "ALT_HOLD", "plane" => "FBWB", "vtol" => "QHOVER", "sub" => "ALT_HOLD"},
    "safe_recovery" => Map.new(~w(copter plane vtol rover boat blimp), &{&1, "RTL"}),
    "mission" => Map.new(~w(copter plane vtol rover boat sub), &{&1, "AUTO"}),
    "land" => %{"copter" => "LAND", "vtol" => "QLAND", "blimp" => "LAND"},
    "takeoff" => %{"plane" => "TAKEOFF", "vtol" => "TAKEOFF"}
  }

  # `allows_arming` of its modes, as of 4.6: those that only make sense in the air. AUTO takes the option that allows it.
  @not_armable %{
    "copter" =>
      ~w(AUTO CIRCLE RTL LAND FLIP AUTOTUNE BRAKE AVOID_ADSB SMART_RTL FOLLOW SYSTEMID AUTOROTATE AUTO_RTL),
    "vtol" => ~w(QLAND QRTL)
  }

  @doc "The mode to be set first, if a vehicle of this kind refuses to be armed in its mode; nil if it does not."
  @spec arm_first(kind :: String.t(), mode :: String.t()) :: String.t() | nil
  def arm_first(kind, mode), do: if(mode in Map.get(@not_armable, kind, []), do: "GUIDED")

  @doc "The modes for MAVLink's standard modes on a kind of vehicle, by their names."
  @spec standard(String.t()) :: %{String.t() => String.t()}
  def standard(kind), do: for({name, %{^kind => mode}} <- @standard, into: %{}, do: {name, mode})

  @doc "The kinds of vehicles with a firmware."
  @spec kinds() :: [String.t()]
  def kinds, do: ~w(copter plane vtol rover boat sub tracker blimp)

  @doc "Number to name for a kind of vehicle (`Aerie.Vehicle.Kind.name/1`); empty for a kind without a firmware."
  @spec names(String.t()) :: %{non_neg_integer() => String.t()}
  def names("copter"), do: @copter
  # ArduPlane flies the VTOLs: its Q modes are part of its table.
  def names(kind) when kind in ["plane", "vtol"], do: @plane
  def names(kind) when kind in ["rover", "boat"], do: @rover
  def names("sub"), do: @sub
  def names("tracker"), do: @tracker
  def names("blimp"), do: @blimp
  def names(_other), do: %{}
end
