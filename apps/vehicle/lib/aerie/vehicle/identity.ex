defmodule Aerie.Vehicle.Identity do
  @moduledoc """
  Who the gateway says it is, and when it says so.

  - Aboard a vehicle it is component 191 (on-board computer) of the vehicle's own system; at a hub a system of its own,
    237 unless configured. 255 belongs to the operator's ground station: the configuration refuses it without
    `mavlink.i_am_the_gcs` (H5, R10).
  - Its heartbeat says MAV_AUTOPILOT_INVALID (H2) and, unless it stands for the ground station, MAV_TYPE_ONBOARD_CONTROLLER,
    which no firmware takes for an operator's.
  - The heartbeat is a dead-man's: it goes out only while the loops that it stands for answer (`Aerie.Identity.Pulse`,
    H3).
  """

  alias Aerie.Vehicle.Options
  alias MavCodec.Messages.Heartbeat

  @types %{onboard_controller: 18, gcs: 6}
  @autopilot_invalid 8
  @active 4
  @critical 5

  @doc """
  Our heartbeat. `:critical` says that some part of the gateway does not answer, though not one that this vehicle depends
  on (MAV_STATE_CRITICAL).
  """
  @spec heartbeat(Options.t(), :active | :critical) :: Heartbeat.t()
  def heartbeat(options, state \\ :active) do
    %Heartbeat{
      type: Map.fetch!(@types, options.heartbeat_type),
      autopilot: @autopilot_invalid,
      system_status: if(state == :active, do: @active, else: @critical),
      mavlink_version: 3
    }
  end

  @doc "Whether a frame or message with this source is our own."
  @spec own?(Options.t(), non_neg_integer(), 0..255) :: boolean()
  def own?(options, system, component),
    do: system == options.own_system and component == options.own_component
end
