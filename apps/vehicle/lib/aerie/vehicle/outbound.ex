defmodule Aerie.Vehicle.Outbound do
  @moduledoc """
  What a session sends: messages to its vehicle by the router, samples to the fleet by the bridge.

  Our heartbeat goes out once a second per way (link and peer), however many vehicles are behind it: the first session
  that is due claims the second. It says on-board computer, never ground station: a ground station's heartbeat would keep
  a vehicle from noticing that its operator is gone (H5).
  """

  alias Aerie.{Fleet, Names, Vehicle}
  alias MavCodec.{Encoder, Enums}
  alias MavCodec.Messages.Heartbeat

  @heartbeat_ms 900

  @enforce_keys [:gateway, :options, :encoder]
  defstruct [:gateway, :options, :encoder]

  @type t :: %__MODULE__{}

  @spec new(Names.gateway(), Vehicle.Options.t()) :: t()
  def new(gateway, options) do
    encoder = Encoder.new(system: options.own_system, component: options.own_component)
    %__MODULE__{gateway: gateway, options: options, encoder: encoder}
  end

  @doc "Sends a message to the vehicle in the MAVLink version that it speaks. No way to it: counted, not kept."
  @spec send(t(), struct(), 1 | 2) :: t()
  def send(outbound, message, version) do
    {bytes, encoder} = Encoder.encode(outbound.encoder, message, version: version)
    outbound = %{outbound | encoder: encoder}

    case Aerie.Router.send(outbound.gateway, outbound.options.key, bytes) do
      :ok -> outbound
      {:error, :no_route} -> unsent(outbound)
    end
  end

  @doc "Sends our heartbeat on the vehicle's way, unless another session has done it within this second."
  @spec heartbeat(t(), 1 | 2) :: t()
  def heartbeat(outbound, version) do
    with way when way != nil <- Aerie.Router.way(outbound.gateway, outbound.options.key),
         true <- Fleet.Store.claim(outbound.gateway, {:heartbeat, way}, @heartbeat_ms) do
      send(outbound, our_heartbeat(), version)
    else
      _nowhere_or_done -> outbound
    end
  end

  @doc "Publishes a sample of a state group: `%{data: map, time_boot_ms: the vehicle's clock or nil}`."
  @spec publish(t(), Vehicle.State.group(), map(), integer()) :: :ok
  def publish(outbound, group, sample, at) do
    Aerie.Bridge.publish_state(outbound.gateway, outbound.options.id, group, sample, at)
  end

  defp unsent(outbound) do
    _count = Fleet.Store.count(outbound.gateway, {:vehicle, outbound.options.id, :unsent})
    outbound
  end

  defp our_heartbeat do
    %Heartbeat{
      type: Enums.MavType.value(:MAV_TYPE_ONBOARD_CONTROLLER),
      autopilot: Enums.MavAutopilot.value(:MAV_AUTOPILOT_INVALID),
      system_status: Enums.MavState.value(:MAV_STATE_ACTIVE),
      mavlink_version: 3
    }
  end
end
