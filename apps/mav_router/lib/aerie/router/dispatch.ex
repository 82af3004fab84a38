defmodule Aerie.Router.Dispatch do
  @moduledoc """
  What the gateway itself says: finds the endpoint that bytes of ours go out by. What others say goes by
  `Aerie.Router.Forward`.
  """

  alias Aerie.LinkProcess
  alias Aerie.Names
  alias Aerie.Router.Carrier
  alias Aerie.Router.Classify
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Out
  alias Aerie.Router.Plan
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables

  @doc "See `Aerie.Router.send/4`."
  @spec send(Names.gateway(), Aerie.Router.vehicle_key(), iodata, keyword) ::
          :ok | {:error, :no_route}
  def send(gateway, {_network, _system} = key, bytes, options) do
    with tables when is_map(tables) <- Tables.of(gateway),
         [_ | _] = ways <- carriers(tables, key, bytes, Keyword.take(options, [:component, :link])) do
      results = for way <- ways, do: send_by(gateway, tables, way, key, bytes)
      if :ok in results, do: :ok, else: {:error, :no_route}
    else
      _none -> {:error, :no_route}
    end
  end

  defp carriers(tables, key, bytes, options) do
    with {link, _peer} = best <- Routes.best(tables, key, options) do
      case Endpoints.owner(tables, link) do
        %{group: group} when group != nil ->
          if options[:link], do: [best], else: of_group(tables, key, bytes, group, best)

        _no_group ->
          [best]
      end
    end
  end

  # Each link of the group by which the system is heard, with the peer of it that was heard last.
  defp of_group(tables, key, bytes, group, best) do
    ways = tables |> Routes.ways(key) |> Enum.uniq_by(&elem(&1, 0))

    owners =
      for {link, _} = way <- Carrier.within_reach(tables, key, [best | List.delete(ways, best)]),
          %{group: ^group} = owner <- [Endpoints.owner(tables, link)],
          into: %{},
          do: {link, {owner, way}}

    carry = owners |> Enum.map(fn {_link, {owner, _way}} -> owner end) |> Carrier.configured(class(bytes))

    for link <- Carrier.links(tables, group, Map.keys(owners), carry),
        do: owners |> Map.fetch!(link) |> elem(1)
  end

  # What is to be signed passes by the link's process, where the order of time stamps is that of sending.
  defp send_by(gateway, tables, {link, peer} = way, key, bytes) do
    case {Aerie.Signing.mark(gateway, key, bytes), Endpoints.get(tables, way)} do
      {{:sign, _, _} = marked, %{key: {_, peer}}} when peer != :self ->
        LinkProcess.write(gateway, link, marked, {:peer, peer})

      {marked, nil} ->
        LinkProcess.write(gateway, link, marked, {:peer, peer})

      {_plain, endpoint} ->
        # Other endpoints' processes tell it themselves.
        if match?({:udp, _, _}, endpoint.out), do: Aerie.Recorder.sent(gateway, link, elem(key, 0), bytes)
        Out.bytes(endpoint, bytes, class(bytes), 1)
    end
  end

  # Ours is what flies or asks, unless its first frame says something else.
  defp class(bytes) do
    case bytes |> IO.iodata_to_binary() |> MavCodec.Frame.header() do
      {:ok, _header, _payload, _total, id, _system} -> Classify.of(id)
      _no_frame -> :control
    end
  end

  @doc "See `Aerie.Router.broadcast/3`."
  @spec broadcast(Names.gateway(), iodata, network :: String.t() | :all) :: :ok
  def broadcast(gateway, bytes, network) do
    with tables when is_map(tables) <- Tables.of(gateway) do
      bytes = IO.iodata_to_binary(bytes)

      for {key, way} <- Plan.read(tables).ways, way.broadcasts, network == :all or network in way.networks do
        # An endpoint that went meanwhile needs none.
        _ = send_by(gateway, tables, key, {hd(way.networks), nil}, bytes)
      end

      :ok
    else
      nil -> :ok
    end
  end
end
