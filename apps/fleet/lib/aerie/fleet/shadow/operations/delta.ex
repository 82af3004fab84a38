defmodule Aerie.Fleet.Shadow.Operations.Delta do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Shadow

  @impl true
  def operation do
    %Operation{
      name: "shadow.delta",
      meaning: "What is desired but not yet so.",
      transfer?: false,
      answer: Shadow.Document.Schema.answers().delta,
      routes: [get("/api/vehicles/:id/shadow/delta", "What is desired but not yet so.")]
    }
  end

  @impl true
  def run(_input, context), do: Shadow.delta(context.gateway, context.vehicle)
end
