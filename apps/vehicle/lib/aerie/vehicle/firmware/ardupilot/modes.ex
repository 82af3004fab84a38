defmodule Aerie.Vehicle.Firmware.Ardupilot.Modes do
  @moduledoc """
  ArduPilot's mode numbers by firmware: the enums of its MAVLink definitions (`COPTER_MODE`, …), the modes that those
  lack, and the names that its own ground stations use.
  """

  @behaviour Aerie.Vehicle.Firmware.Modes

  import Bitwise

  alias Aerie.Vehicle.Firmware.Modes
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

  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
  @custom 0x01

  @impl true
  def arm_first(kind, mode), do: if(mode in Map.get(@not_armable, kind, []), do: "GUIDED")

  @impl true
  def standard(kind), do: for({name, %{^kind => mode}} <- @standard, into: %{}, do: {name, mode})

  @impl true
  def kinds, do: ~w(copter plane vtol rover boat sub tracker blimp)

  @impl true
  def name(kind, _base, custom), do: Map.get(names(kind), custom) || Modes.numbered(custom)

  @impl true
  def number(kind, name) do
    Enum.find_value(names(kind), :error, fn {number, known} -> if known == name, do: {:ok, number} end)
  end

  @impl true
  def asked(kind, base, custom) when band(base, @custom) != 0, do: [name(kind, base, custom)]
  # It refuses what is not a mode of its own; older ones had modes for the flags.
  def asked(kind, base, _custom), do: [Modes.Flags.name(kind, base, 0)]

  # It keeps one byte of the number.
  @impl true
  def wrong(mode), do: if(mode not in 0..255, do: "the mode #{mode} is not an integer from 0 to 255")

  @impl true
  def all(kind), do: kind |> names() |> Enum.sort() |> Enum.map(&elem(&1, 1))

  # Number to name; empty for a kind without a firmware.
  defp names("copter"), do: @copter
  # ArduPlane flies the VTOLs: its Q modes are part of its table.
  defp names(kind) when kind in ["plane", "vtol"], do: @plane
  defp names(kind) when kind in ["rover", "boat"], do: @rover
  defp names("sub"), do: @sub
  defp names("tracker"), do: @tracker
  defp names("blimp"), do: @blimp
  defp names(_other), do: %{}
end
