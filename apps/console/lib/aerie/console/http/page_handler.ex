defmodule Aerie.Console.HTTP.PageHandler do
  @moduledoc "Answers the GET of a page if its `Host` is a name of the gateway. A foreign name that points here (DNS rebinding) gets nothing."

  @behaviour :cowboy_handler

  alias Aerie.Access.HTTP.{Admission, Request}
  alias Phoenix.LiveView.Cowboy.Page

  @impl :cowboy_handler
  def init(request, %{policy: policy, server: server} = state) do
    case Admission.host(policy, Request.facts(request)) do
      :ok ->
        # Telemetry goes first. Each request has a process of its own.
        _normal = Process.flag(:priority, :low)
        {:ok, request, _server} = Page.init(request, server)
        {:ok, request, state}

      {:error, error} ->
        headers = %{"content-type" => "text/plain; charset=utf-8"}
        {:ok, :cowboy_req.reply(error.status, headers, error.message <> "\n", request), state}
    end
  end

  @doc "Whether both the `Host` and the `Origin` of a WebSocket request are ours."
  @spec own?(Admission.policy(), :cowboy_req.req()) :: boolean()
  def own?(policy, request) do
    facts = Request.facts(request)
    Admission.host(policy, facts) == :ok and Admission.origin(policy, facts) == :ok
  end
end
