defmodule MavRouter.Router.View do
  @moduledoc "The endpoints as plain maps, for people and programs (`MavRouter.Router.endpoints/1`)."

  alias MavRouter.Endpoints
  alias MavRouter.Forward.Table
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Routes
  alias MavRouter.Tables
  alias MavRouter.Endpoints.Counters

  @doc "All endpoints, in the order of their ids."
  @spec endpoints(Tables.t()) :: [map]
  def endpoints(tables) do
    paths = Table.read(tables).paths
    heard = Routes.systems(tables)

    for endpoint <- Enum.sort_by(Endpoints.list(tables), & &1.key), path = paths[endpoint.key] do
      %{
        id: endpoint.key,
        owner: path.owner,
        side: path.side,
        kind: endpoint.kind,
        peer: endpoint.text,
        networks: path.networks,
        group: path.group,
        role: path.role,
        sniffer: path.sniffer,
        high_latency: path.high_latency,
        id_offsets: path.renumber || %{},
        hidden: hidden(heard, path),
        since: endpoint.since,
        waiting: max(:atomics.get(endpoint.waiting, 1), 0),
        counters: Counters.read(endpoint.counters),
        rates:
          :ets.lookup_element(tables.scores, {:rates, endpoint.key}, 2, %{
            frames_in: 0.0,
            frames_out: 0.0,
            bytes_out: 0.0
          })
      }
    end
  end

  # If two networks have a system with the same id, the one named first is seen.
  defp hidden(_heard, %{networks: [_one]}), do: []

  defp hidden(heard, path) do
    systems = fn network ->
      for {system, key} <- Map.get(heard, network, []), key != path.key, uniq: true, do: system
    end

    seen = fn network -> Enum.map(systems.(network), &Renumber.seen(path.renumber, network, &1)) end

    for {network, i} <- Enum.with_index(path.networks),
        earlier = path.networks |> Enum.take(i) |> Enum.flat_map(seen),
        system <- systems.(network),
        Renumber.seen(path.renumber, network, system) in earlier,
        do: {network, system}
  end
end
