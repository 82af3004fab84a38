defmodule Aerie.Api.Rest.Handler do
  @moduledoc """
  Serves `/api`: JSON in and out, for programs. `Aerie.Access.HTTP.Admission` decides who may use it; `docs/clients.md` describes
  it.

  Each request is counted by its status (`{:api, status}`).
  """

  @behaviour :cowboy_handler

  alias Aerie.Base.{Json, Store}
  alias Aerie.Access.Changes
  alias Aerie.Access.HTTP.{Admission, Error, Request}
  alias Aerie.Api.Rest.{Actions, Misdirected, Routes}
  alias Aerie.Access.{KeyRing, Principals}

  @json "application/json; charset=utf-8"
  @binary "application/octet-stream"

  @impl :cowboy_handler
  def init(request, %{resource: resource, gateway: gateway, policy: policy} = state) do
    state = %{state | policy: KeyRing.admit(policy, gateway)}
    method = :cowboy_req.method(request)
    facts = Request.facts(request)
    everywhere = Map.merge(common(), cross_origin(resource, state.policy, facts))
    request = :cowboy_req.set_resp_headers(everywhere, request)

    {status, headers, body, request} =
      case answer(method, resource, facts, state, request) do
        {:ok, status, object, request} -> {status, %{}, object, request}
        {:error, %Error{} = error, request} -> {error.status, error.headers, Error.body(error), request}
      end

    Store.count_if_running(gateway, {:api, status})
    {:ok, reply(status, headers, body, request), state}
  end

  # A CORS preflight: a page of an allowed origin asks what it may send, without its key.
  defp answer("OPTIONS", resource, %{origin: origin} = facts, state, request)
       when is_binary(origin) and resource != :missing do
    case Admission.origin(state.policy, facts) do
      :ok -> {:ok, 204, nil, request}
      {:error, error} -> {:error, error, request}
    end
  end

  defp answer("OPTIONS", resource, facts, state, request) when resource != :missing do
    case Admission.decide(state.policy, facts) do
      {:ok, _requester} -> {:ok, 204, nil, :cowboy_req.set_resp_header("allow", methods(resource), request)}
      {:error, error} -> {:error, error, request}
    end
  end

  defp answer(method, resource, facts, state, request) do
    with {:ok, requester} <- Admission.decide(state.policy, facts),
         {:ok, route} <- Routes.find(resource, method),
         :ok <- Admission.may(requester, route.role),
         :ok <-
           Misdirected.check(
             route.change || route.action,
             state.gateway,
             :cowboy_req.binding(:id, request, nil)
           ) do
      route.action
      |> Actions.run(with_requester(state, requester), request)
      |> recorded(route, %{name: "http:" <> requester.name, from: Changes.place(facts.peer)}, state.gateway)
    else
      {:error, error} ->
        if error.status == 401 and facts.key != nil,
          do: Changes.sign_in(state.gateway, :refused, "http", nil, facts.peer)

        {:error, error, request}
    end
  end

  defp with_requester(state, requester),
    do: Map.merge(state, %{requester: requester, source: Principals.commanding(requester)})

  # What was changed is in the audit log, as for the console.
  defp recorded({:ok, _status, body, request} = answer, %{change: change}, by, gateway) do
    if Changes.recorded?(change),
      do: Changes.request(gateway, by, change, :cowboy_req.binding(:id, request, nil), body)

    answer
  end

  defp recorded(answer, _route, _by, _gateway), do: answer

  defp reply(_status, _headers, :sent, request), do: request
  defp reply(204, headers, nil, request), do: :cowboy_req.reply(204, headers, request)

  # Sends the size that was read first, because a file that is being written grows.
  defp reply(status, headers, {:file, path, bytes}, request) do
    name = Path.basename(path)
    type = %{"content-type" => @binary, "content-disposition" => ~s(attachment; filename="#{name}")}
    :cowboy_req.reply(status, Map.merge(headers, type), {:sendfile, 0, bytes, path}, request)
  end

  defp reply(status, headers, {:text, type, text, name}, request) do
    # A file name on board may contain any characters.
    name = String.replace(name, ~r/[^A-Za-z0-9._-]/, "_")
    more = %{"content-type" => type, "content-disposition" => ~s(attachment; filename="#{name}")}
    :cowboy_req.reply(status, Map.merge(headers, more), text, request)
  end

  defp reply(status, headers, body, request),
    do:
      :cowboy_req.reply(
        status,
        Map.put(headers, "content-type", @json),
        [Json.encode_to_iodata!(body), ?\n],
        request
      )

  defp common, do: %{"cache-control" => "no-store", "x-content-type-options" => "nosniff"}

  defp methods(resource), do: Enum.join(Routes.methods(resource), ", ")

  defp cross_origin(resource, policy, %{origin: origin} = facts) when is_binary(origin) do
    case Admission.origin(policy, facts) do
      :ok ->
        %{
          "access-control-allow-origin" => origin,
          "access-control-allow-headers" => "x-aerie-key, authorization, content-type",
          "access-control-allow-methods" => methods(resource),
          "access-control-max-age" => "600",
          "vary" => "origin"
        }

      {:error, _error} ->
        %{"vary" => "origin"}
    end
  end

  defp cross_origin(_resource, _policy, _facts), do: %{"vary" => "origin"}
end
