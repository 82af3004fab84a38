defmodule Aerie.Fleet.Shadow.Operations.Delete do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Shadow

  @impl true
  def operation do
    %Operation{
      name: "shadow.delete",
      meaning: "Clears the desired state.",
      changes?: true,
      transfer?: false,
      request: Shadow.Document.Schema.delete(),
      once: Shadow.Document.Schema.version_of_signed(),
      answer: Shadow.Document.Schema.answers().delete,
      routes: [delete("/api/vehicles/:id/shadow", "Clears the desired state.", query: [:version])]
    }
  end

  @impl true
  def run(%{object: object}, context),
    do: Shadow.delete(context.gateway, context.vehicle, object, context.source, context.via)
end
