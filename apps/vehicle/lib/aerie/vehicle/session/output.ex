defmodule Aerie.Vehicle.Session.Output do
  @moduledoc """
  What a session sends: messages to its vehicle through the router, samples to the fleet through the bridge.

  Our heartbeat (`MavRouter.Identity.Heartbeat`) is sent by the first session that is due on a path, however many
  vehicles are on it.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias MavRouter.Identity.Heartbeat
  alias MavCodec.Message
  alias MavCodec.Frame.Encoder

  @enforce_keys [:gateway, :options, :encoder]
  defstruct [:gateway, :options, :encoder]

  @type t :: %__MODULE__{}

  @spec new(Names.gateway(), Vehicle.Options.t()) :: t()
  def new(gateway, options) do
    # A vehicle whose own id is above 255 understands such ids (N1).
    sysid32? = options.system_id > 255
    encoder = Encoder.new(system: options.own_system, component: options.own_component, sysid32: sysid32?)
    %__MODULE__{gateway: gateway, options: options, encoder: encoder}
  end

  @doc """
  Sends a message to its target component of the vehicle in the MAVLink version that it speaks, by the path that brings
  it, or by `link`. A message to a vehicle without a route is dropped and counted (`unsent`), and so is one that this
  version cannot say: without its extension fields it would be another message.
  """
  @spec send(t(), struct(), 1 | 2, link :: term()) :: t()
  def send(%{gateway: gateway, options: options} = output, %module{} = message, version, link \\ nil) do
    with nil <- Message.unsayable(message, version),
         {bytes, encoder} = Encoder.encode(output.encoder, message, version: version),
         output = %{output | encoder: encoder},
         to = [component: component(message)] ++ by(link),
         {:sent, :ok} <- {:sent, MavRouter.Router.send(gateway, options.key, bytes, to)} do
      Store.count(gateway, {:sent, module.id()})
      output
    else
      _unsayable_or_no_route ->
        Store.count(gateway, {:vehicle, options.id, :unsent})
        output
    end
  end

  # A camera or a gimbal may be on a socket of its own (R1).
  defp component(%{target_component: component}) when is_integer(component), do: component
  defp component(_to_all), do: 0

  defp by(nil), do: []
  defp by(link), do: [link: link]

  @doc "Sends our heartbeat on the vehicle's path, unless another session has just done so or it is held back (H3)."
  @spec heartbeat(t(), 1 | 2, link :: term()) :: t()
  def heartbeat(%{gateway: gateway, options: options} = output, version, link \\ nil) do
    with %{} = heartbeat <- Heartbeat.message(gateway, options.key, options.heartbeat_type),
         path when path != nil <- MavRouter.Router.route(gateway, options.key, by(link)),
         true <- Heartbeat.claim(gateway, path) do
      send(output, heartbeat, version, link)
    else
      _held_no_route_or_sent -> output
    end
  end

  @doc "Keeps our heartbeat off the vehicle's path for a while, because the vehicle would take it for its operator's."
  @spec withhold(t()) :: :ok
  def withhold(%{gateway: gateway, options: options}) do
    case MavRouter.Router.route(gateway, options.key) do
      nil -> :ok
      path -> Heartbeat.withhold(gateway, path)
    end
  end

  @doc "Publishes a sample of a state group: `%{data: map, time_boot_ms: ms or nil}`."
  @spec publish(t(), Vehicle.State.group(), map(), integer()) :: :ok
  def publish(output, group, sample, at) do
    case output.options do
      %{publisher: nil} -> :ok
      %{publisher: publisher, id: id} -> publisher.publish_state(output.gateway, id, group, sample, at)
    end
  end
end
