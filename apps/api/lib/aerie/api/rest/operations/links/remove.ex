defmodule Aerie.Api.Rest.Operations.Links.Remove do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias MavRouter.Link

  @impl true
  def operation do
    summary = "Closes and forgets a link."

    %Operation{
      name: "link.remove",
      meaning: "Removes a link.",
      transfer?: false,
      fields: [field(:id, {:bytes, 512}, "the link", required: true)],
      routes: [delete("/api/links/:id", summary, change: :remove_link, status: 204)]
    }
  end

  @impl true
  def run(%{id: id}, %{gateway: gateway}) do
    if Link.get(gateway, id),
      do: Link.stop(gateway, id),
      else: {:error, {:unknown, "no link has this id; see /api/links"}}
  end
end
