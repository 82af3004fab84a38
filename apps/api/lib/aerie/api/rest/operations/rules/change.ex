defmodule Aerie.Api.Rest.Operations.Rules.Change do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Api.Rest.Operations.Rules
  alias MavRouter.Router

  @impl true
  def operation do
    summary = "Changes the rules of a link or client."

    %Operation{
      name: "rules.change",
      meaning: summary,
      transfer?: false,
      request: Router.rules_schema(),
      answer: Rules.List.operation().answer,
      answer_as: "rules",
      routes: [patch("/api/rules/:id", summary, change: :change_rules)]
    }
  end

  @impl true
  def run(%{object: object}, %{gateway: gateway} = context) do
    {id, object} = Map.pop(object, "id")
    with :ok <- Router.change_rules(gateway, id, object), do: Rules.List.run(%{}, context)
  end
end
