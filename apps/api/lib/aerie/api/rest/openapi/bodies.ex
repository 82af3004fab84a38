defmodule Aerie.Api.Rest.OpenAPI.Bodies do
  @moduledoc """
  The schemas of the bodies of `/api` by the names that routes have: as strict as what reads them, but for the content
  of connection strings, plans and files of parameters. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Fleet.{Operations, Shadow}
  alias Aerie.Vehicle.Command
  alias MavRouter.Endpoints.RulesSchema

  @doc "All of them."
  @spec all() :: %{(atom() | String.t()) => map()}
  def all do
    own = %{
      object: %{type: :object},
      nothing: object(%{}),
      rules: RulesSchema.change(),
      command: %{oneOf: for(type <- Command.Types.all(), do: Command.Schema.envelope(type, type?: true))},
      result: Command.Schema.result(),
      under_way:
        object(%{id: token(), vehicle: token(), state: %{const: "under_way"}}, [:id, :vehicle, :state])
    }

    own
    |> Map.merge(Aerie.Api.Rest.Operations.schemas())
    |> Map.merge(Command.Schema.shared())
    |> Map.merge(Operations.Schema.shared())
    |> Map.merge(Shadow.Schema.shared())
    |> Map.put("reported", Shadow.Schema.reported())
  end
end
