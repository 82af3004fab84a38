defmodule Aerie.Vehicle.Modes.Ardupilot do
  @moduledoc """
  ArduPilot's mode numbers, per firmware: the enums of its MAVLink definitions (`COPTER_MODE`, …), with the modes that those
  do not have, and with the names by which its own ground stations know the others.
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
  # There is no enum of these.
  @blimp %{0 => "LAND", 1 => "MANUAL", 2 => "VELOCITY", 3 => "LOITER", 4 => "RTL", 5 => "AUTO", 6 => "HOLD"}

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
