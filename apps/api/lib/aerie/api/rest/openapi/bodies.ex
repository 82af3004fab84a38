defmodule Aerie.Api.Rest.OpenAPI.Bodies do
  @moduledoc """
  The schemas of the bodies and answers of `/api` by the names that routes have. Those of bodies are as strict as what
  reads them, but for the content of connection strings, plans and files of parameters. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Api.Rest.View
  alias Aerie.Base.Json.Object

  @doc "All of them."
  @spec all() :: %{(atom() | String.t()) => map()}
  def all do
    own = %{
      nothing: object(%{}),
      under_way: under_way()
    }

    answers()
    |> Map.new(fn {name, fields} -> {name, Object.schema(fields)} end)
    |> Map.merge(own)
    |> Map.merge(Aerie.Api.Rest.Operations.schemas())
    |> Map.merge(Aerie.Fleet.schemas())
  end

  defp answers do
    Map.merge(View.answers(), %{
      recorder: View.Recordings.fields(),
      signing_capability: View.SigningCapability.fields()
    })
  end

  # Where it was asked for by its id, with more.
  defp under_way do
    more = %{type: %{type: :string}, source: %{type: [:string, :null]}, progress: %{}}
    own = %{id: token(), vehicle: token(), state: %{const: "under_way"}}
    object(Map.merge(more, own), Map.keys(own))
  end
end
