defmodule SimVehicle.Firmware.Personality do
  @moduledoc """
  The behaviour of a firmware: everything that ArduPilot and PX4 do differently. Functions take and return the vehicle, and add
  actions for the core to carry out.
  """

  alias SimVehicle.{Params, Vehicle}
  alias SimVehicle.Services.Command

  @doc "The parameter table with the firmware's values."
  @callback params() :: Params.t()

  @doc "How the mission protocol is spoken (`SimVehicle.Plans`)."
  @callback plan_style() :: :ardupilot | :px4

  @doc "Streams without being asked: messages per second by message id."
  @callback rates() :: %{non_neg_integer => number}

  @doc "Speeds (m/s), radii and heights (m) of flight, from the parameters (`SimVehicle.Flight`)."
  @callback limits(Params.t()) :: map

  @doc "Power-up: first mode, texts, boot bytes."
  @callback boot(Vehicle.t()) :: Vehicle.t()

  @doc "Called in every step, after time has moved on."
  @callback tick(Vehicle.t()) :: Vehicle.t()

  @doc "True when a message to `{system, component}` is for this vehicle."
  @callback addressed?(Vehicle.t(), {integer, integer}) :: boolean

  @callback command(Vehicle.t(), Command.t()) :: Vehicle.t()
  @callback message(Vehicle.t(), struct, {integer, integer}) :: Vehicle.t()
  @callback text(Vehicle.t(), 0..7, String.t()) :: Vehicle.t()

  @doc "A ground station's heartbeat was heard."
  @callback gcs_heard(Vehicle.t(), integer) :: Vehicle.t()

  @doc "Something happened in flight (`SimVehicle.Flight`)."
  @callback flight_event(Vehicle.t(), term) :: Vehicle.t()

  @callback failsafe(Vehicle.t(), atom, boolean) :: Vehicle.t()

  @doc "A plan (0 mission, 1 fence, 2 rally) was replaced or cleared."
  @callback plan_changed(Vehicle.t(), :stored | :cleared, 0..2) :: Vehicle.t()

  @doc "Message `id` if the firmware has its own form of it; `:common` for the shared form."
  @callback telemetry(Vehicle.t(), non_neg_integer) :: struct | nil | :common

  @doc "Starts the RTL item of a mission, or any other mode change that a mission item requires."
  @callback mission_rtl(Vehicle.t()) :: {:goal, map} | {:vehicle, Vehicle.t()}
end
