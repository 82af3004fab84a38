defmodule Aerie.Vehicle.Services.Identity do
  @moduledoc """
  The gateway's MAVLink identity and its heartbeat.

  - Aboard a vehicle it is component 191 (on-board computer) of the vehicle's own system; at a hub it is a system of its own,
    237 unless configured. 255 belongs to the operator's ground station: the configuration refuses it without
    `mavlink.i_am_the_gcs` (H5, R10).
  - Its heartbeat says MAV_AUTOPILOT_INVALID (H2) and MAV_TYPE_ONBOARD_CONTROLLER, which no firmware takes for an
    operator's; MAV_TYPE_GCS if it is the ground station.
  - The heartbeat works as a dead man's switch: it is sent only while the loops that it vouches for answer
    (`MavRouter.Identity.Watchdog`, H3).
  """

  alias Aerie.Vehicle.Options
  alias MavCodec.Enums.{MavAutopilot, MavState, MavType}
  alias MavCodec.Messages.Heartbeat

  @types %{
    onboard_controller: MavType.value(:MAV_TYPE_ONBOARD_CONTROLLER),
    gcs: MavType.value(:MAV_TYPE_GCS)
  }
  @autopilot_invalid MavAutopilot.value(:MAV_AUTOPILOT_INVALID)
  @states %{active: MavState.value(:MAV_STATE_ACTIVE), critical: MavState.value(:MAV_STATE_CRITICAL)}

  @doc "The MAV_TYPE of our heartbeat."
  @spec type(Options.t()) :: 0..255
  def type(options), do: Map.fetch!(@types, options.heartbeat_type)

  @doc """
  Our heartbeat. `:critical`: a part of the gateway that this vehicle does not depend on does not answer
  (MAV_STATE_CRITICAL).
  """
  @spec heartbeat(Options.t(), :active | :critical) :: Heartbeat.t()
  def heartbeat(options, state \\ :active) do
    %Heartbeat{
      type: type(options),
      autopilot: @autopilot_invalid,
      system_status: Map.fetch!(@states, state),
      mavlink_version: 3
    }
  end
end
