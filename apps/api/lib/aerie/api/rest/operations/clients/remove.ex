defmodule Aerie.Api.Rest.Operations.Clients.Remove do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  @impl true
  def operation do
    summary = "Removes an endpoint, or disconnects a client."

    %Operation{
      name: "client.remove",
      meaning: "Removes an endpoint for clients, or a client.",
      transfer?: false,
      fields: [field(:id, {:bytes, 512}, "the endpoint or client", required: true)],
      routes: [delete("/api/clients/:id", summary, change: :remove_client, status: 204)]
    }
  end

  @impl true
  def run(%{id: id}, context), do: MavRouter.Client.remove(context.gateway, id)
end
