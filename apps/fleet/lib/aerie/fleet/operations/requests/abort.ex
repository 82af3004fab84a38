defmodule Aerie.Fleet.Operations.Requests.Abort do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    meaning = "Stops an operation, gives up what is under way, and ends the flights of those that have begun."

    %Operation{
      name: "operation.abort",
      meaning: meaning,
      changes?: true,
      transfer?: false,
      fields: [Schema.id(), Schema.ending(:rtl)],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [post("/api/operations/:id/abort", meaning, [])]
    }
  end

  @impl true
  def run(%{id: id, command: type}, context),
    do: Operations.change(context.gateway, id, {:abort, Atom.to_string(type)}, context.source, context.via)
end
