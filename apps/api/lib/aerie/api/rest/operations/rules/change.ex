defmodule Aerie.Api.Rest.Operations.Rules.Change do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Api.Rest.View
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
      answer: View.answers().rules_in_force,
      routes: [patch("/api/rules/:id", summary, change: :change_rules)]
    }
  end

  @impl true
  def run(%{object: object}, %{gateway: gateway}) do
    {id, object} = Map.pop(object, "id")

    case RuleChanges.parse(object) do
      {:ok, changes} -> with :ok <- Router.configure(gateway, id, changes), do: {:ok, View.rules(gateway)}
      {:error, words} -> {:error, {:invalid, words}}
    end
  end
end
