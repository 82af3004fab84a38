defmodule Aerie.Control.Policy.FlightPath.Volume do
  @moduledoc """
  How much room a vehicle takes around the places of its way, and how high it may climb there by itself, as its firmware
  has it (`Aerie.Vehicle.Firmware.Room`). One that is not known takes the most that any of them would.
  """

  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Firmware.Room

  # How far a curve leaves the straight line between its ends, at most, as a share of that line: its speeds at both
  # ends together are at most four times its length (`SplineCurve`), which count a seventh.
  @curve 0.6
  # Assumed where nothing is known.
  @curve_m 300
  @rise_m 120

  @doc "The room at a place. `:long` - how long the way to it is; `:rise` - how high it is above home; nil: not known."
  @spec room(Intent.sweep(), %{long: number() | nil, rise: number() | nil}, Context.t()) :: Room.t()
  def room(nil, _way, _context), do: Room.none()
  # Not a vehicle that was heard, but a description that leaves its firmware open.
  def room(_sweep, _way, %{autopilot: nil}), do: Room.none()
  def room(:curve, way, _context), do: Room.given((way.long || @curve_m) * @curve, "the way there is a curve")
  def room(:takeoff, way, context), do: room({:takeoff, max(way.rise || @rise_m, 0)}, way, context)

  def room(sweep, _way, context) do
    context.autopilot
    |> Firmware.rooms()
    |> Enum.map(& &1.room(sweep, context.vehicle_type || "unknown", context.params))
    |> Room.larger()
  end
end
