defmodule Aerie.Router.Wishes do
  @moduledoc """
  Clients' own requests for rates on their way to a vehicle (SET_MESSAGE_INTERVAL, REQUEST_DATA_STREAM): noted as the
  client's wants, and forwarded only where they take nothing from another client (`Aerie.Vehicle.Streams`). What is not
  forwarded is answered here, in the vehicle's name.
  """

  alias Aerie.Fleet.Store
  alias Aerie.Names
  alias Aerie.Router.Endpoint
  alias Aerie.Router.Filter
  alias Aerie.Router.Out
  alias Aerie.Router.Plan.Way
  alias Aerie.Vehicle.Streams
  alias MavCodec.Frame

  @doc "The frames that go on. `heard` are those whose signature was right, or that need none: only they are noted."
  @spec pass(Names.gateway(), Way.t(), [Frame.t()], heard :: [Frame.t()]) :: [Frame.t()]
  def pass(gateway, %{side: :client, role: :full} = way, frames, heard) do
    # Nearly always there is none.
    if Enum.any?(frames, &Streams.request?/1),
      do: Enum.reject(frames, &(Streams.request?(&1) and &1 in heard and absorbed?(gateway, way, &1))),
      else: frames
  end

  def pass(_gateway, _way, frames, _heard), do: frames

  defp absorbed?(gateway, way, frame) do
    with true <- way.in == nil or Filter.pass?(way.in, frame, way.owner),
         {system, _component} <- Frame.target(frame),
         network when network != nil <- Enum.find(way.networks, &Store.vehicle(gateway, {&1, system})),
         {:absorb, answer} <- Streams.intercept(gateway, network, client(way.key), frame) do
      if answer, do: Out.bytes(way, answer, :ack, 1)
      true
    else
      _goes_on -> false
    end
  end

  @doc "An endpoint is gone, and what was wanted by it with it."
  @spec forget(Endpoint.t()) :: :ok
  def forget(%Endpoint{gateway: gateway, key: key}), do: Streams.forget(gateway, client(key))

  defp client(key), do: {:endpoint, key}
end
