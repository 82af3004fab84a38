defmodule Aerie.Fleet.Operations.Requests.Continue do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    %Operation{
      name: "operation.continue",
      meaning: "Continues an operation with the vehicles that have not begun, in your name.",
      changes?: true,
      transfer?: false,
      fields: [Schema.id()],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [
        post(
          "/api/operations/:id/continue",
          "Continues an operation with the vehicles that have not begun, in your name.",
          []
        )
      ]
    }
  end

  @impl true
  def run(%{id: id}, context),
    do: Operations.change(context.gateway, id, :continue, context.source, context.via)
end
