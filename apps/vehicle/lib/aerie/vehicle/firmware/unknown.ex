defmodule Aerie.Vehicle.Firmware.Unknown do
  @moduledoc """
  A firmware that is neither ArduPilot nor PX4. It is sent no commands, because it is not known which ones it supports and what
  its parameters mean.
  """

  @behaviour Aerie.Vehicle.Protocol
  @behaviour Protocols.Mission.Firmware

  @impl true
  def gap(_type, _kind, _firmware), do: "Aerie knows how to command ArduPilot and PX4, not this firmware"

  @impl true
  def steps(command, vehicle), do: {:error, gap(command.type, vehicle.kind, vehicle.autopilot)}

  @impl true
  def encode(_step, _attempt, _vehicle), do: []

  @impl true
  def cancel(_step, _vehicle), do: []

  @impl true
  def release(_step, _vehicle), do: []

  @impl true
  def read(_step, _message, _source, _vehicle), do: :ignore

  @impl true
  def listens(_step), do: []

  @impl true
  def param_encoding, do: :c_cast

  @impl true
  def setpoints_first?(_command, _vehicle), do: false

  @impl true
  def home_is_item_0?, do: false

  @impl true
  def plan_gap(_mission_type, _firmware), do: nil
  @impl true
  def item_offset, do: -1

  @impl true
  def kept(_item, _mission_type, _kind), do: %{}

  @impl true
  def plan_watch_us(_mission_type), do: 0

  @impl true
  def plan_verdict(_message, _mission_type, _opaque_id), do: :ignore
end
