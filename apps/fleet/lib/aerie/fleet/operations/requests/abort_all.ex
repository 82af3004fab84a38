defmodule Aerie.Fleet.Operations.Requests.AbortAll do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    meaning =
      "Aborts all operations, and ends the flights of all vehicles in your charge or in nobody's."

    %Operation{
      name: "operation.abort_all",
      meaning: meaning,
      changes?: true,
      transfer?: false,
      fields: [Schema.ending(:hold)],
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [post("/api/abort", meaning, [])]
    }
  end

  @impl true
  def run(%{command: type}, context),
    do: Operations.abort_all(context.gateway, Atom.to_string(type), context.source, context.via)
end
