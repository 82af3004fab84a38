defmodule Aerie.Fleet.Operations.Requests.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    %Operation{
      name: "operation.get",
      meaning: "An operation, and what became of each vehicle.",
      transfer?: false,
      fields: [Schema.id()],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [get("/api/operations/:id", "An operation, and what became of each vehicle.")]
    }
  end

  @impl true
  def run(%{id: id}, context), do: Operations.get(context.gateway, id)
end
