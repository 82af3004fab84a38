defmodule Aerie.Router.View do
  @moduledoc "What people and programs may know of the endpoints: plain maps (`Aerie.Router.endpoints/1`)."

  alias Aerie.Router.Endpoints
  alias Aerie.Router.Plan
  alias Aerie.Router.Renumber
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables
  alias Aerie.Router.Tally

  @doc "All endpoints, in the order of their ids."
  @spec endpoints(Tables.t()) :: [map]
  def endpoints(tables) do
    ways = Plan.read(tables).ways
    heard = Routes.systems(tables)

    for endpoint <- Enum.sort_by(Endpoints.list(tables), & &1.key), way = ways[endpoint.key] do
      %{
        id: endpoint.key,
        owner: way.owner,
        side: way.side,
        kind: endpoint.kind,
        peer: endpoint.text,
        networks: way.networks,
        group: way.group,
        role: way.role,
        sniffer: way.sniffer,
        high_latency: way.high_latency,
        id_offsets: way.renumber || %{},
        hidden: hidden(heard, way),
        since: endpoint.since,
        waiting: max(:atomics.get(endpoint.waiting, 1), 0),
        counters: Tally.read(endpoint.tally),
        rates:
          :ets.lookup_element(tables.scores, {:rates, endpoint.key}, 2, %{
            frames_in: 0.0,
            frames_out: 0.0,
            bytes_out: 0.0
          })
      }
    end
  end

  # Of two networks that have a system of the same id, the one that is named first is seen.
  defp hidden(_heard, %{networks: [_one]}), do: []

  defp hidden(heard, way) do
    systems = fn network ->
      for {system, key} <- Map.get(heard, network, []), key != way.key, uniq: true, do: system
    end

    seen = fn network -> Enum.map(systems.(network), &Renumber.seen(way.renumber, network, &1)) end

    for {network, i} <- Enum.with_index(way.networks),
        earlier = way.networks |> Enum.take(i) |> Enum.flat_map(seen),
        system <- systems.(network),
        Renumber.seen(way.renumber, network, system) in earlier,
        do: {network, system}
  end
end
