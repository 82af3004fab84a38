defmodule Aerie.Fleet.Operations.Requests.Begin do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.{Request, Schema}

  @impl true
  def operation do
    summary = "Begins an operation on many vehicles, which goes on by itself."

    %Operation{
      name: "operation.begin",
      meaning: "Begins an operation on many vehicles.",
      changes?: true,
      transfer?: false,
      request: Schema.request(),
      once: {"id", :always, "id: an operation over NATS has one, so that a copy of it is the same one"},
      answer: Schema.operation(true),
      answer_as: "operation",
      routes: [post("/api/operations", summary, status: 202, max_bytes: Request.max_bytes())]
    }
  end

  @impl true
  def run(%{object: object}, context),
    do: Operations.begin(context.gateway, object, context.source, context.via)
end
