defmodule Aerie.Api.Monitoring do
  @moduledoc """
  Serves `/metrics` (Prometheus), `/healthz` (the process answers), `/readyz` (it can do its work), and an index of them. Each
  request runs in its own process and only reads the read model.
  """

  @behaviour :cowboy_handler

  alias Aerie.Access.HTTP.{Admission, Request}
  alias Aerie.Access.KeyRing
  alias Aerie.Fleet.Health
  alias Aerie.Api.Metrics

  @json "application/json; charset=utf-8"
  @text "text/plain; charset=utf-8"
  @allow %{"allow" => "GET, HEAD"}

  @impl :cowboy_handler
  def init(request, %{page: page, gateway: gateway, policy: policy} = state) do
    request =
      case policy |> KeyRing.admit(gateway) |> Admission.host(Request.facts(request)) do
        :ok -> asked(:cowboy_req.method(request), page, gateway, request)
        {:error, error} -> reply(request, error.status, @text, error.message <> "\n")
      end

    {:ok, request, state}
  end

  defp asked(method, page, gateway, request) when method in ["GET", "HEAD"],
    do: answer(page, gateway, request)

  defp asked("OPTIONS", _page, _gateway, request), do: reply(request, 204, @text, "", @allow)

  defp asked(_other, _page, _gateway, request),
    do: reply(request, 405, @text, "method not allowed: use GET\n", @allow)

  defp answer(:metrics, gateway, request),
    do: reply(request, 200, Metrics.Text.content_type(), Metrics.Text.render(Metrics.families(gateway)))

  defp answer(:healthz, _gateway, request), do: reply(request, 200, @json, JSON.encode!(%{status: "ok"}))

  defp answer(:readyz, gateway, request) do
    {ready?, report} = Health.ready(gateway)
    reply(request, if(ready?, do: 200, else: 503), @json, JSON.encode!(report))
  end

  defp answer(:index, _gateway, request) do
    reply(request, 200, @text, """
    Aerie gateway

    /metrics   counters and gauges in Prometheus text
    /healthz   200 while the gateway's process answers
    /readyz    200 when it can do its work; else 503 and why not
    /api       JSON for programs: /api/status, /api/vehicles, /api/links
    """)
  end

  defp answer(:missing, _gateway, request),
    do: reply(request, 404, @text, "not found; available are /metrics, /healthz, /readyz and /api\n")

  defp reply(request, status, type, body, more \\ %{}) do
    headers =
      Map.merge(
        %{"content-type" => type, "cache-control" => "no-store", "x-content-type-options" => "nosniff"},
        more
      )

    :cowboy_req.reply(status, headers, body, request)
  end
end
