defmodule Aerie.Api.Metrics.Clients do
  @moduledoc """
  Metric families about clients: connected clients and their frames, requests to `/api`, and refusals. Clients come and go, so
  they are summed by kind; their ids are not labels.
  """

  alias Aerie.Api.Metrics.Text

  @doc """
  The families, from the clients (`MavRouter.Client.list/1`), the endpoints to which they connect (`MavRouter.Client.endpoints/1`) and the read
  model's counters.
  """
  @spec families([map()], [map()], map()) :: [Text.family()]
  def families(clients, endpoints, counters) do
    kinds = Enum.group_by(clients, & &1.kind)

    sums = fn count ->
      for {kind, clients} <- Enum.sort(kinds), do: {[kind: kind], clients |> Enum.map(count) |> Enum.sum()}
    end

    requests = for {{:api, status}, n} <- counters, is_integer(status), do: {[status: status], n}
    refused = for {{:clients, interface, why}, n} <- counters, do: {[interface: interface, reason: why], n}

    [
      {"gateway_clients", :gauge, "Clients connected or heard, by kind.", sums.(fn _client -> 1 end)},
      {"gateway_client_received_frames", :gauge, "Frames from the clients that are connected now.",
       sums.(& &1.counters.frames_in)},
      {"gateway_client_sent_frames", :gauge, "Frames to the clients that are connected now.",
       sums.(& &1.counters.frames_out)},
      {"gateway_client_dropped_frames", :gauge,
       "Frames dropped because clients that are connected now read too slowly.",
       sums.(&MavRouter.Client.dropped/1)},
      {"gateway_client_unread_datagrams", :gauge,
       "Datagrams from clients dropped before they were read, by reason; of the endpoints that there are now.",
       for(
         reason <- [:kernel_dropped, :shed, :shed_new],
         do: {[reason: reason], endpoints |> Enum.map(&Map.fetch!(&1.counters, reason)) |> Enum.sum()}
       )},
      {"gateway_client_endpoints_overloaded", :gauge,
       "Endpoints for clients to which datagrams come faster than they are read.",
       [{[], Enum.count(endpoints, &(&1[:overload] != nil))}]},
      {"gateway_api_requests_total", :counter, "Requests to /api, by status of the answer.",
       Enum.sort(requests)},
      {"gateway_clients_refused_total", :counter, "Clients refused or disconnected, by interface and reason.",
       Enum.sort(refused)}
    ]
  end

  @doc "Whether these families show a counter."
  @spec own?(term()) :: boolean()
  def own?({:api, _status}), do: true
  def own?({:clients, _interface, _why}), do: true
  def own?(_other), do: false
end
