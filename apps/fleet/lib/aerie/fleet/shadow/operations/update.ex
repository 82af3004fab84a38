defmodule Aerie.Fleet.Shadow.Operations.Update do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Shadow

  @impl true
  def operation do
    %Operation{
      name: "shadow.update",
      meaning: "Changes the desired state.",
      changes?: true,
      transfer?: false,
      request: Shadow.Document.Schema.update(),
      once: Shadow.Document.Schema.version_of_signed(),
      answer: Shadow.Document.Schema.answers().update,
      routes: [patch("/api/vehicles/:id/shadow", "Changes the desired state.")]
    }
  end

  @impl true
  def run(%{object: object}, context),
    do: Shadow.update(context.gateway, context.vehicle, object, context.source, context.via)
end
