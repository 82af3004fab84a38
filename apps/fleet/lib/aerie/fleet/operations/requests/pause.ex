defmodule Aerie.Fleet.Operations.Requests.Pause do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    %Operation{
      name: "operation.pause",
      meaning: "Pauses an operation: no further vehicle is begun until it is continued.",
      changes?: true,
      transfer?: false,
      fields: [Schema.id()],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [
        post(
          "/api/operations/:id/pause",
          "Pauses an operation: no further vehicle is begun until it is continued.",
          []
        )
      ]
    }
  end

  @impl true
  def run(%{id: id}, context), do: Operations.change(context.gateway, id, :pause, context.source, context.via)
end
