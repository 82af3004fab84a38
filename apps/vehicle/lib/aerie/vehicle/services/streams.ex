defmodule Aerie.Vehicle.Services.Streams do
  @moduledoc """
  Which messages a vehicle sends at which rates, arbitrated between the gateway and all its clients.

      Aerie.Vehicle.Services.Streams.want(gateway, {"main", 1}, self(), 30, 10)
      Aerie.Base.Store.vehicle(gateway, {"main", 1}).streams

  Clients' rates come through `want/5` and `forget/2`, or from their own requests (`intercept/4`). The vehicle's session then
  requests the highest rate of each message (`Aerie.Vehicle.Services.Streams.Arbiter`). The demand is kept in the store
  (`Aerie.Vehicle.Services.StreamDemand`) and outlives the session.
  """

  @behaviour MavRouter.Sharing.StreamRequests

  alias Aerie.Vehicle.Services.StreamDemand
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias Aerie.Vehicle.Services.Streams.Intercept
  alias MavCodec.Enums.MavResult
  alias MavCodec.Frame

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)

  @doc """
  A client wants a message (by its id) at this rate (1/s) or more; nil withdraws that. If the client is a pid, or a tuple with
  a pid in front, its demands end with that process.
  """
  @spec want(Names.gateway(), Store.vehicle_key(), StreamDemand.client(), StreamDemand.what(), number() | nil) ::
          :ok | {:error, :too_many}
  def want(gateway, key, client, what, hz) do
    case StreamDemand.put(gateway, key, client, what, hz) do
      :ok -> notify(gateway, key, nil)
      :same -> :ok
      error -> error
    end
  end

  @doc "Withdraws all demands of a client."
  @impl MavRouter.Sharing.StreamRequests
  @spec forget(Names.gateway(), StreamDemand.client()) :: :ok
  def forget(gateway, client),
    do: gateway |> StreamDemand.forget(client) |> Enum.each(&notify(gateway, &1, nil))

  @doc """
  A client's frame to a vehicle for which `request?/1` is true: `:forward` it as it is, or `{:absorb, answer}`, where
  `answer` is a frame to the client in the vehicle's name, or nil. The client's demand is recorded.

  A frame to an unknown vehicle, to all systems (target 0) or to a component other than the autopilot is forwarded and not
  recorded. While only high-latency links reach the vehicle, the answer is MAV_RESULT_TEMPORARILY_REJECTED. With
  `mavlink.request_streams` off, everything is forwarded.
  """
  @impl MavRouter.Sharing.StreamRequests
  @spec intercept(Names.gateway(), network :: String.t(), StreamDemand.client(), Frame.t()) ::
          :forward | {:absorb, binary() | nil}
  def intercept(gateway, network, client, frame) do
    with {system, component} when system != 0 <- Frame.target(frame),
         %{component: autopilot, streams: streams} = vehicle
         when component in [0, autopilot] and map_size(streams) > 0 <-
           Store.vehicle(gateway, {network, system}),
         {:high_latency, false} <- {:high_latency, match?(%{high_latency: %{only?: true}}, vehicle)},
         {:ok, message} <- MavCodec.decode(frame) do
      key = {network, system}
      others = StreamDemand.merged(gateway, key, {:but, client})

      case Intercept.decide(message, others) do
        :pass ->
          :forward

        {:forward, id, hz} ->
          forward(gateway, key, client, id, hz)

        {:absorb, what, hz} ->
          absorb(gateway, key, client, what, hz, Intercept.answer(frame, autopilot, @accepted))
      end
    else
      {:high_latency, true} ->
        {:absorb, Intercept.answer(frame, autopilot(gateway, network, frame), @temporarily_rejected)}

      _no_known_vehicle ->
        :forward
    end
  end

  defp autopilot(gateway, network, frame) do
    {system, _component} = Frame.target(frame)
    Store.vehicle(gateway, {network, system}).component
  end

  @doc "Whether a frame requests a rate. Cheap, because it is called for every frame to a vehicle."
  @impl MavRouter.Sharing.StreamRequests
  @spec request?(Frame.t()) :: boolean()
  defdelegate request?(frame), to: Intercept

  defp forward(gateway, key, client, id, hz) do
    _full_is_counted = StreamDemand.put(gateway, key, client, id, hz)
    notify(gateway, key, if(hz, do: id))
    :forward
  end

  defp absorb(gateway, key, client, what, hz, answer) do
    changes = for one <- List.wrap(what), do: StreamDemand.put(gateway, key, client, one, hz)
    if :ok in changes, do: notify(gateway, key, nil)
    Store.count(gateway, {:streams, :absorbed})
    {:absorb, answer}
  end

  defp notify(gateway, key, forwarded) do
    with session when is_pid(session) <- Names.whereis(gateway, :session, key),
         do: send(session, {:demand, forwarded})

    :ok
  end
end
