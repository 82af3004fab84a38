defmodule Aerie.Vehicle.Outbound do
  @moduledoc """
  What a session sends: messages to its vehicle by the router, samples to the fleet by the bridge.

  Our heartbeat (`Aerie.Vehicle.Identity`) goes out once a second per way (link and peer), however many vehicles are behind
  it: the first session that is due claims the second. While a loop that it stands for does not answer it is held back,
  counted as `{:identity, :held}`.
  """

  alias Aerie.{Names, Store, Vehicle}
  alias Aerie.Identity.Pulse
  alias Aerie.Vehicle.Identity
  alias MavCodec.Encoder

  @heartbeat_ms 900
  @withheld_ms 3_000

  @enforce_keys [:gateway, :options, :encoder]
  defstruct [:gateway, :options, :encoder]

  @type t :: %__MODULE__{}

  @spec new(Names.gateway(), Vehicle.Options.t()) :: t()
  def new(gateway, options) do
    # A vehicle with an id of more than a byte was heard, so such ids are understood here (N1).
    long? = options.system_id > 255
    encoder = Encoder.new(system: options.own_system, component: options.own_component, sysid32: long?)
    %__MODULE__{gateway: gateway, options: options, encoder: encoder}
  end

  @doc """
  Sends a message to the vehicle in the MAVLink version that it speaks: by the way that it was heard last, or by the link
  `by`. No way to it: counted, not kept.
  """
  @spec send(t(), struct(), 1 | 2, by :: term()) :: t()
  def send(outbound, message, version, by \\ nil) do
    {bytes, encoder} = Encoder.encode(outbound.encoder, message, version: version)
    outbound = %{outbound | encoder: encoder}

    case transmit(outbound, bytes, by) do
      :ok -> sent(outbound, message)
      {:error, _no_way} -> unsent(outbound)
    end
  end

  defp transmit(outbound, bytes, nil), do: Aerie.Router.send(outbound.gateway, outbound.options.key, bytes)

  defp transmit(outbound, bytes, link),
    do: Aerie.Router.send(outbound.gateway, outbound.options.key, bytes, link: link)

  defp sent(outbound, %module{}) do
    Store.count(outbound.gateway, {:sent, module.id()})
    outbound
  end

  @doc """
  Sends our heartbeat on the vehicle's way, unless another session has done it within this second or a loop that it stands
  for does not answer (H3).
  """
  @spec heartbeat(t(), 1 | 2, by :: term()) :: t()
  def heartbeat(%{gateway: gateway, options: options} = outbound, version, by \\ nil) do
    with {:alive, []} <- {:alive, Pulse.silent(gateway, options.key)},
         way when way != nil <- Aerie.Router.way(gateway, options.key, if(by, do: [link: by], else: [])),
         false <- Store.claimed?(gateway, {:withheld, way}, @withheld_ms),
         true <- Store.claim(gateway, {:heartbeat, way}, @heartbeat_ms) do
      state = if Pulse.any_silent?(gateway), do: :critical, else: :active
      send(outbound, Identity.heartbeat(options, state), version, by)
    else
      {:alive, _silent} ->
        Store.count(gateway, {:identity, :held})
        outbound

      _nowhere_or_done ->
        outbound
    end
  end

  @doc """
  Keeps our heartbeat from the vehicle's way for the next seconds: the vehicle would take it for its operator's. Others on
  the same way do without it too, for a way is heard by all.
  """
  @spec withhold(t()) :: :ok
  def withhold(%{gateway: gateway} = outbound) do
    with way when way != nil <- Aerie.Router.way(gateway, outbound.options.key) do
      Store.claim(gateway, {:withheld, way}, 1)
      Store.count(gateway, {:identity, :withheld})
      :ok
    else
      nil -> :ok
    end
  end

  @doc "Publishes a sample of a state group: `%{data: map, time_boot_ms: the vehicle's clock or nil}`."
  @spec publish(t(), Vehicle.State.group(), map(), integer()) :: :ok
  def publish(outbound, group, sample, at) do
    case outbound.options do
      %{fleet: nil} -> :ok
      %{fleet: fleet, id: id} -> fleet.publish_state(outbound.gateway, id, group, sample, at)
    end
  end

  defp unsent(outbound) do
    _count = Store.count(outbound.gateway, {:vehicle, outbound.options.id, :unsent})
    outbound
  end
end
