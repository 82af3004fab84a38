defmodule Aerie.Fleet.Operations.Requests.Stop do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    %Operation{
      name: "operation.stop",
      meaning: "Stops an operation: no further vehicle is begun.",
      changes?: true,
      transfer?: false,
      fields: [Schema.id()],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [delete("/api/operations/:id", "Stops an operation: no further vehicle is begun.")]
    }
  end

  @impl true
  def run(%{id: id}, context), do: Operations.change(context.gateway, id, :stop, context.source, context.via)
end
