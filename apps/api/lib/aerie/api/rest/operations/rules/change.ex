defmodule Aerie.Api.Rest.Operations.Rules.Change do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Api.Rest.Operations.Rules
  alias MavRouter.Endpoints.RuleChanges
  alias MavRouter.Router

  @impl true
  def operation do
    summary = "Changes the rules of a link or client."

    %Operation{
      name: "rules.change",
      meaning: summary,
      transfer?: false,
      request: RuleChanges.schema(),
      answer: Rules.List.operation().answer,
      answer_as: "rules",
      routes: [patch("/api/rules/:id", summary, change: :change_rules)]
    }
  end

  @impl true
  def run(%{object: object}, %{gateway: gateway} = context) do
    {id, object} = Map.pop(object, "id")

    case RuleChanges.parse(object) do
      {:ok, changes} -> with :ok <- Router.configure(gateway, id, changes), do: Rules.List.run(%{}, context)
      {:error, words} -> {:error, {:invalid, words}}
    end
  end
end
