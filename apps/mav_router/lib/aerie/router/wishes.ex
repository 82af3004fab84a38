defmodule Aerie.Router.Wishes do
  @moduledoc """
  Clients' own requests for rates on their way to a vehicle (SET_MESSAGE_INTERVAL, REQUEST_DATA_STREAM): noted as the
  client's wants, and forwarded only where they take nothing from another client (`Aerie.Router.Requests`). What is not
  forwarded is answered here, in the vehicle's name.
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Router.Endpoint
  alias Aerie.Router.Filter
  alias Aerie.Router.Out
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.Renumber
  alias Aerie.Router.Tables
  alias MavCodec.Frame

  @doc "The frames that go on. `heard` are those whose signature was right, or that need none: only they are noted."
  @spec pass(Names.gateway(), Tables.t(), Way.t(), [Frame.t()], heard :: [Frame.t()]) :: [Frame.t()]
  def pass(
        gateway,
        %{requests: requests},
        %{side: :client, role: :full, commands: true} = way,
        frames,
        heard
      )
      when requests != nil do
    # Nearly always there is none.
    if Enum.any?(frames, &requests.request?/1),
      do:
        Enum.reject(
          frames,
          &(requests.request?(&1) and &1 in heard and absorbed?(gateway, requests, way, &1))
        ),
      else: frames
  end

  def pass(_gateway, _tables, _way, frames, _heard), do: frames

  defp absorbed?(gateway, requests, way, frame) do
    with true <- way.in == nil or Filter.pass?(way.in, frame, way.owner),
         {id, _component} <- Frame.target(frame),
         {network, system} <- vehicle(gateway, way, id),
         {:ok, frame} <- Renumber.inward(frame, system),
         {:absorb, answer} <- requests.intercept(gateway, network, client(way.key), frame) do
      if answer, do: answer(way, network, IO.iodata_to_binary(answer))
      true
    else
      _goes_on -> false
    end
  end

  # Under the id that the client means: it may see others (`Aerie.Router.Renumber`).
  defp vehicle(gateway, way, id) do
    Enum.find_value(way.networks, fn network ->
      system = Renumber.meant(way.renumber, network, id)
      if system != nil and Store.vehicle(gateway, {network, system}), do: {network, system}
    end)
  end

  defp answer(%{renumber: nil} = way, _network, bytes), do: Out.bytes(way, bytes, :ack, 1)

  # In the vehicle's name, as the client knows it; it is addressed to the client.
  defp answer(way, network, bytes) do
    frame = Frame.from_bytes(bytes, nil)

    case Renumber.outward(way.renumber, %{way | networks: [network]}, frame, fn _system -> true end) do
      {:ok, frame} -> Out.bytes(way, frame.bytes, :ack, 1)
      :refused -> :ok
    end
  end

  @doc "An endpoint is gone, and what was wanted by it with it."
  @spec forget(Tables.t(), Endpoint.t()) :: :ok
  def forget(%{requests: nil}, _endpoint), do: :ok

  def forget(%{requests: requests}, %Endpoint{gateway: gateway, key: key}),
    do: requests.forget(gateway, client(key))

  defp client(key), do: {:endpoint, key}
end
