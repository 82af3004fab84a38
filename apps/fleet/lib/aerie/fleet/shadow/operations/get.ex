defmodule Aerie.Fleet.Shadow.Operations.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Shadow

  @impl true
  def operation do
    %Operation{
      name: "shadow.get",
      meaning: "What is desired of a vehicle, and what is reported.",
      transfer?: false,
      answer: Shadow.Document.Schema.answers().get,
      routes: [
        get(
          "/api/vehicles/:id/shadow",
          "What is desired of a vehicle, what is reported, and how they differ."
        )
      ]
    }
  end

  @impl true
  def run(_input, context), do: Shadow.get(context.gateway, context.vehicle)
end
