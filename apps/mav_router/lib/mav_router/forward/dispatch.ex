defmodule MavRouter.Forward.Dispatch do
  @moduledoc """
  The gateway's own frames: finds the endpoint by which they go out. Frames of others go through `MavRouter.Forward`.
  """

  alias MavRouter.LinkProcess
  alias Aerie.Base.Names
  alias MavRouter.Routes.LinkSelector
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.Output
  alias MavRouter.Forward.Table
  alias MavRouter.Forward.Holders
  alias MavRouter.Tables

  @doc "See `MavRouter.Router.send/4`."
  @spec send(Names.gateway(), MavRouter.Router.vehicle_key(), iodata, keyword) ::
          :ok | {:error, :no_route}
  def send(gateway, {_network, _system} = key, bytes, options) do
    with tables when is_map(tables) <- Tables.of(gateway),
         [_ | _] = endpoints <- carriers(tables, key, bytes, Keyword.take(options, [:component, :link])) do
      results = for endpoint <- endpoints, do: send_by(gateway, tables, endpoint, key, bytes)
      if :ok in results, do: :ok, else: {:error, :no_route}
    else
      _none -> {:error, :no_route}
    end
  end

  defp carriers(tables, key, bytes, options) do
    now = System.monotonic_time(:millisecond)

    tables
    |> Holders.way(key, options, now)
    |> Enum.flat_map(fn {link, _peer} = endpoint ->
      case Endpoints.owner(tables, link) do
        %{group: group} when group != nil ->
          if options[:link], do: [endpoint], else: of_group(tables, key, bytes, group, endpoint, now)

        _no_group ->
          [endpoint]
      end
    end)
    |> Enum.uniq()
  end

  # Each link of the group by which the system is heard, with the peer of it that was heard last.
  defp of_group(tables, key, bytes, group, best, now) do
    endpoints = tables |> Holders.endpoints(key, 0, now) |> Enum.uniq_by(&elem(&1, 0))

    owners =
      for {link, _} = endpoint <-
            LinkSelector.within_reach(tables, key, [best | List.delete(endpoints, best)]),
          %{group: ^group} = owner <- [Endpoints.owner(tables, link)],
          into: %{},
          do: {link, {owner, endpoint}}

    carry =
      owners |> Enum.map(fn {_link, {owner, _endpoint}} -> owner end) |> LinkSelector.configured(class(bytes))

    for link <- LinkSelector.links(tables, group, Map.keys(owners), carry),
        do: owners |> Map.fetch!(link) |> elem(1)
  end

  # Frames to be signed go through the link's process, where the order of time stamps is that of sending.
  defp send_by(gateway, tables, {link, peer} = endpoint_key, key, bytes) do
    case {MavRouter.Signing.mark(gateway, key, bytes), Endpoints.get(tables, endpoint_key)} do
      {{:sign, _, _} = marked, %{key: {_, peer}}} when peer != :self ->
        LinkProcess.write(gateway, link, marked, {:peer, peer})

      {marked, nil} ->
        LinkProcess.write(gateway, link, marked, {:peer, peer})

      {_plain, endpoint} ->
        # The processes of other endpoints tell the recorder themselves.
        if match?({:udp, _, _}, endpoint.out), do: MavRouter.Recorder.sent(gateway, link, elem(key, 0), bytes)
        Output.bytes(endpoint, bytes, class(bytes), 1)
    end
  end

  # The class of the first frame.
  defp class(bytes) do
    case bytes |> IO.iodata_to_binary() |> MavCodec.Frame.header() do
      {:ok, _header, _payload, _total, id, _system} -> TrafficClass.of(id)
      _no_frame -> :control
    end
  end

  @doc "See `MavRouter.Router.broadcast/3`."
  @spec broadcast(Names.gateway(), iodata, network :: String.t() | :all) :: :ok
  def broadcast(gateway, bytes, network) do
    with tables when is_map(tables) <- Tables.of(gateway) do
      bytes = IO.iodata_to_binary(bytes)

      for {key, path} <- Table.read(tables).paths,
          path.broadcasts,
          network == :all or network in path.networks do
        # An endpoint that is gone meanwhile needs none.
        _ = send_by(gateway, tables, key, {hd(path.networks), nil}, bytes)
      end

      :ok
    else
      nil -> :ok
    end
  end
end
