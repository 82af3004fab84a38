defmodule Aerie.Api.Rest.Operations.Rules.Reset do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  @impl true
  def operation do
    %Operation{
      name: "rules.reset",
      meaning: "Restores the configured rules of a link or client.",
      transfer?: false,
      fields: [field(:id, {:bytes, 512}, "the link or client", required: true)],
      routes: [delete("/api/rules/:id", "Restores the configured rules.", change: :reset_rules, status: 204)]
    }
  end

  @impl true
  def run(%{id: id}, context), do: MavRouter.Router.reset(context.gateway, id)
end
