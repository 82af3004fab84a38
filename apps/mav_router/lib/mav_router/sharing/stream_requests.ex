defmodule MavRouter.Sharing.StreamRequests do
  @moduledoc """
  Requests of clients for message rates (SET_MESSAGE_INTERVAL, REQUEST_DATA_STREAM). A module with these callbacks,
  given to `MavRouter.Router.Supervisor` (`:requests`), arbitrates between them: it notes them, and they are forwarded
  only if they take nothing from another client. The others are answered here, in the vehicle's name. Without such a
  module all are forwarded.
  """

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Forward.Delivery
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Output
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavCodec.Frame

  @doc "Whether a frame is such a request. Must be cheap: it is asked of every frame of a client."
  @callback request?(Frame.t()) :: boolean

  @doc """
  A client's request to a vehicle of a network: `:forward` it, or `{:absorb, answer}`, where `answer` is a frame to the
  client in the vehicle's name, or nil.
  """
  @callback intercept(Names.gateway(), network :: String.t(), client :: term, Frame.t()) ::
              :forward | {:absorb, binary | nil}

  @doc "A client is gone: its requests are forgotten."
  @callback forget(Names.gateway(), client :: term) :: :ok

  @doc "The delivery without the frames that are not forwarded; only trusted ones are noted."
  @spec pass(Delivery.t()) :: Delivery.t()
  def pass(
        %{
          frames: frames,
          tables: %{requests: requests},
          path: %{side: :client, role: :full, commands: true}
        } = delivery
      )
      when requests != nil do
    # Nearly always there is none.
    if Enum.any?(frames, &requests.request?/1),
      do: %{delivery | frames: Enum.reject(frames, &absorbed?(&1, delivery))},
      else: delivery
  end

  def pass(delivery), do: delivery

  defp absorbed?(frame, %{gateway: gateway, tables: %{requests: requests}, path: path, trusted: trusted}) do
    with true <- requests.request?(frame) and frame in trusted,
         true <- path.in == nil or Filter.pass?(path.in, frame, path.owner),
         {id, _component} <- Frame.target(frame),
         {network, system} <- vehicle(gateway, path, id),
         {:ok, frame} <- Renumber.inward(frame, system),
         {:absorb, answer} <- requests.intercept(gateway, network, {:endpoint, path.key}, frame) do
      if answer, do: Output.answer(path, network, IO.iodata_to_binary(answer))
      true
    else
      _forwarded -> false
    end
  end

  # The client may see other ids (`MavRouter.Endpoints.Owner.Renumber`).
  defp vehicle(gateway, path, id) do
    Enum.find_value(path.networks, fn network ->
      system = Renumber.meant(path.renumber, network, id)
      if system != nil and Store.vehicle(gateway, {network, system}), do: {network, system}
    end)
  end
end
