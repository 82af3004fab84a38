defmodule FleetWeb.Metrics.Clients do
  @moduledoc "Metric families of what serves clients: requests to `/api`, and who was refused."

  alias FleetWeb.Metrics.Text

  @doc "The families, from the read model's counters."
  @spec families(map()) :: [Text.family()]
  def families(counters) do
    requests = for {{:api, status}, n} <- counters, is_integer(status), do: {[status: status], n}
    refused = for {{:clients, face, why}, n} <- counters, do: {[face: face, reason: why], n}

    [
      {"gateway_api_requests_total", :counter, "Requests to /api, by status of the answer.",
       Enum.sort(requests)},
      {"gateway_clients_refused_total", :counter, "Clients refused or let go, by face and reason.",
       Enum.sort(refused)}
    ]
  end

  @doc "Whether a counter is shown by these families."
  @spec own?(term()) :: boolean()
  def own?({:api, _status}), do: true
  def own?({:clients, _face, _why}), do: true
  def own?(_other), do: false
end
