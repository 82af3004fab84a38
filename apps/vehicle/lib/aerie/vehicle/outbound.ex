defmodule Aerie.Vehicle.Outbound do
  @moduledoc """
  What a session sends: messages to its vehicle by the router, samples to the fleet by the bridge.

  Our heartbeat (`Aerie.Vehicle.Identity`) goes out once a second per way (link and peer), however many vehicles are behind
  it: the first session that is due claims the second. While a loop that it stands for does not answer it is held back,
  counted as `{:identity, :held}`.
  """

  alias Aerie.{Fleet, Names, Vehicle}
  alias Aerie.Vehicle.Identity
  alias MavCodec.Encoder

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
      :ok -> sent(outbound, message)
      {:error, :no_route} -> unsent(outbound)
    end
  end

  defp sent(outbound, %module{}) do
    Fleet.Store.count(outbound.gateway, {:sent, module.id()})
    outbound
  end

  @doc """
  Sends our heartbeat on the vehicle's way, unless another session has done it within this second or a loop that it stands
  for does not answer (H3).
  """
  @spec heartbeat(t(), 1 | 2) :: t()
  def heartbeat(%{gateway: gateway, options: options} = outbound, version) do
    with {:alive, []} <- {:alive, Identity.Pulse.silent(gateway, options.key)},
         way when way != nil <- Aerie.Router.way(gateway, options.key),
         true <- Fleet.Store.claim(gateway, {:heartbeat, way}, @heartbeat_ms) do
      state = if Identity.Pulse.any_silent?(gateway), do: :critical, else: :active
      send(outbound, Identity.heartbeat(options, state), version)
    else
      {:alive, _silent} ->
        Fleet.Store.count(gateway, {:identity, :held})
        outbound

      _nowhere_or_done ->
        outbound
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
end
