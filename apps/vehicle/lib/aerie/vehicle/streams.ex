defmodule Aerie.Vehicle.Streams do
  @moduledoc """
  Which messages a vehicle sends how often, arbitrated between the gateway and all its clients.

      Aerie.Vehicle.Streams.want(gateway, {"main", 1}, self(), 30, 10)
      Aerie.Vehicle.Streams.show(gateway, {"main", 1})

  Who serves clients tells their wants (`want/5`, `forget/2`) or lets their own requests be seen (`intercept/4`). The
  vehicle's session then asks the vehicle for the highest rate of each message (`Aerie.Vehicle.Streams.Arbiter`). Wants are
  kept in the store (`Aerie.Fleet.Wants`) and outlive the session.
  """

  @behaviour Aerie.Router.Requests

  alias Aerie.Fleet.Wants
  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Vehicle.Streams.Intercept
  alias MavCodec.Frame

  @accepted 0
  @temporarily_rejected 1

  @doc """
  A client wants a message (by its id) so many times a second, at least; nil takes that back. A client that is a pid, or a
  tuple with one in front, takes its wants with it when it ends.
  """
  @spec want(Names.gateway(), Store.vehicle_key(), Wants.client(), Wants.what(), number() | nil) ::
          :ok | {:error, :too_many}
  def want(gateway, key, client, what, hz) do
    case Wants.put(gateway, key, client, what, hz) do
      :ok -> tell(gateway, key, nil)
      :same -> :ok
      error -> error
    end
  end

  @doc "A client is gone: all that it wanted of all vehicles is taken back."
  @impl Aerie.Router.Requests
  @spec forget(Names.gateway(), Wants.client()) :: :ok
  def forget(gateway, client), do: gateway |> Wants.forget(client) |> Enum.each(&tell(gateway, &1, nil))

  @doc """
  To be called for a client's frame that is on its way to a vehicle, when `request?/1` says so: `:forward` it as it is, or
  `{:absorb, answer}`, `answer` being a frame to the client in the vehicle's name, or nil. The want is noted.

  A frame for a vehicle that is not known, for all (target 0) or for another component than the autopilot is forwarded
  and not noted. While a vehicle is reached by links of high latency only, the answer is that it cannot be done now. With `mavlink.request_streams` off
  everything is forwarded.
  """
  @impl Aerie.Router.Requests
  @spec intercept(Names.gateway(), network :: String.t(), Wants.client(), Frame.t()) ::
          :forward | {:absorb, binary() | nil}
  def intercept(gateway, network, client, frame) do
    with {system, component} when system != 0 <- Frame.target(frame),
         %{component: autopilot, streams: streams} = vehicle
         when component in [0, autopilot] and streams != %{} <- Store.vehicle(gateway, {network, system}),
         {:spared, false} <- {:spared, match?(%{high_latency: %{only?: true}}, vehicle)},
         {:ok, message} <- MavCodec.decode(frame) do
      key = {network, system}

      note(
        gateway,
        key,
        client,
        Intercept.decide(message, Wants.merged(gateway, key, {:but, client})),
        frame,
        autopilot
      )
    else
      # Nobody can have a rate of it now.
      {:spared, true} ->
        {:absorb, Intercept.answer(frame, autopilot(gateway, network, frame), @temporarily_rejected)}

      _not_for_a_vehicle ->
        :forward
    end
  end

  defp autopilot(gateway, network, frame) do
    {system, _component} = Frame.target(frame)
    Store.vehicle(gateway, {network, system}).component
  end

  @doc "Whether a frame is a request for a rate: cheap, for every frame on its way to a vehicle."
  @impl Aerie.Router.Requests
  @spec request?(Frame.t()) :: boolean()
  defdelegate request?(frame), to: Intercept

  defp note(_gateway, _key, _client, :pass, _frame, _autopilot), do: :forward

  defp note(gateway, key, client, {:forward, id, hz}, _frame, _autopilot) do
    _full_is_counted = Wants.put(gateway, key, client, id, hz)
    tell(gateway, key, if(hz, do: id))
    :forward
  end

  defp note(gateway, key, client, {:absorb, what, hz}, frame, autopilot) do
    changes = for one <- List.wrap(what), do: Wants.put(gateway, key, client, one, hz)
    if :ok in changes, do: tell(gateway, key, nil)
    Store.count(gateway, {:streams, :absorbed})
    {:absorb, Intercept.answer(frame, autopilot, @accepted)}
  end

  @doc """
  What is wanted of a vehicle and how far that has come, by message id: `%{state, wanted, asked, measured}` (states in
  `Aerie.Vehicle.Streams.Line`, rates in messages per second, nil for none). At most a second old.
  """
  @spec show(Names.gateway(), Store.vehicle_key()) :: %{non_neg_integer() => map()}
  def show(gateway, key) do
    case Store.vehicle(gateway, key) do
      %{streams: streams} -> streams
      _unknown -> %{}
    end
  end

  defp tell(gateway, key, forwarded) do
    with session when is_pid(session) <- Names.whereis(gateway, :session, key),
         do: send(session, {:wants, forwarded})

    :ok
  end
end
