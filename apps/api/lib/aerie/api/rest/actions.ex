defmodule Aerie.Api.Rest.Actions do
  @moduledoc "What the methods of `Aerie.Api.Rest.Routes` do: read the request, call Aerie's public functions, answer."

  alias Aerie.Control.Policy

  alias Aerie.Api.Rest.{OpenAPI, Operations}
  alias Aerie.Access.HTTP.Error

  alias Aerie.Api.Rest.View.{Recordings, SigningCapability}
  alias Aerie.Api.Rest.{Routes, View}
  alias Aerie.Access.HTTP.Request
  alias Aerie.Access.Tickets

  @typedoc "A body is an object, a file as `{:file, path, bytes}`, text or bytes as `{:text, content_type, text, name}`, nothing, or `:sent` already."
  @type result ::
          {:ok, 200..299,
           map()
           | {:file, Path.t(), non_neg_integer()}
           | {:text, String.t(), iodata(), String.t()}
           | :sent
           | nil, :cowboy_req.req()}
          | {:error, Error.t(), :cowboy_req.req()}

  @doc "Runs an action. `state` has the gateway, the requester, and as whom that one commands (`:source`)."
  @spec run(atom() | tuple(), map(), :cowboy_req.req()) :: result()
  def run(:index, _state, request), do: {:ok, 200, %{resources: Routes.index()}, request}
  def run(:openapi, _state, request), do: {:ok, 200, OpenAPI.document(), request}
  def run(:status, state, request), do: {:ok, 200, View.status(state.gateway), request}
  def run(:diagnosis, state, request), do: {:ok, 200, View.diagnosis(state.gateway), request}

  def run(:vehicles, state, request),
    do: {:ok, 200, View.vehicles(state.gateway, Request.parameters(request)["tag"]), request}

  def run(:vehicle, state, request), do: answer(vehicle(state, request), 200, request)

  def run(:signing_capability, state, request),
    do: {:ok, 200, SigningCapability.of(state.gateway), request}

  def run(:vehicle_signing, state, request) do
    with {:ok, vehicle} <- vehicle(state, request) do
      found(vehicle.signing, Error.new(:not_found, "this vehicle has no key"))
    end
    |> answer(200, request)
  end

  def run(:issue_ticket, state, request) do
    case Tickets.issue(state.gateway, state.requester) do
      {:ok, ticket, seconds} -> {:ok, %{ticket: ticket, expires_s: seconds}}
      {:error, :too_many} -> {:error, Error.new(:too_many, "too many tickets wait to be used")}
      {:error, :unavailable} -> {:error, Error.new(:unavailable, "tickets are restarting; try again")}
    end
    |> answer(201, request)
  end

  def run(:recorder, state, request) do
    state.gateway
    |> Recordings.all()
    |> found(Error.new(:not_found, "no recorder runs"))
    |> answer(200, request)
  end

  def run(:download, state, request) do
    state.gateway
    |> Recordings.download(:cowboy_req.binding(:name, request))
    |> found(Error.new(:not_found, "no recording has this name; see /api/recorder"))
    |> answer(200, request)
  end

  def run({:operation, choices}, state, request), do: Operations.run(choices, state, request)

  def run(:policy, state, request),
    do:
      state.gateway
      |> View.policy()
      |> found(Error.new(:not_found, "the gateway has no policy"))
      |> answer(200, request)

  def run(:reload_config, %{reload: nil}, request),
    do:
      answer(
        {:error, Error.new(:unavailable, "this gateway has no configuration to read again")},
        200,
        request
      )

  def run(:reload_config, state, request) do
    case state.reload.("http:" <> state.source.name) do
      {:ok, report} ->
        {:ok, report}

      {:error, lines} ->
        message = "the configuration was not reloaded; the old one stays in force"
        {:error, %{Error.new(:invalid, message) | details: %{errors: lines}}}
    end
    |> answer(200, request)
  end

  def run(:reload_policy, state, request) do
    case Policy.reload(state.gateway, "http:" <> state.source.name) do
      :ok ->
        {:ok, View.policy(state.gateway)}

      {:error, lines} ->
        {:error,
         %{
           Error.new(:invalid, "the policy was not loaded; the old one stays in force")
           | details: %{errors: lines}
         }}
    end
    |> answer(200, request)
  end

  defp id(request), do: :cowboy_req.binding(:id, request)
  defp vehicle(state, request), do: state.gateway |> View.vehicle(id(request)) |> found(unknown_vehicle())

  defp unknown_vehicle, do: Error.new(:not_found, "no vehicle has this name; see /api/vehicles")

  defp found(nil, error), do: {:error, error}
  defp found(object, _error), do: {:ok, object}

  defp answer({:ok, object}, status, request), do: {:ok, status, object, request}
  defp answer({:error, error}, _status, request), do: {:error, Error.from(error), request}
end
