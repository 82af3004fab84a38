defmodule Aerie.Api.Rest.Operations.Rules.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object

  @rule Object.fields([
          {:now, :any, nil, "the rule in force"},
          {:configured, :any, nil, "the configured one"}
        ])
  @answer Object.fields([
            {:changed, {:map, {:map, {:object, @rule}}}, nil,
             "the rules that differ from the configured ones, of each link and client by its id"}
          ])

  @impl true
  def operation do
    %Operation{
      name: "rules.list",
      meaning: "Lists the routing rules that differ from the configured ones.",
      transfer?: false,
      answer: @answer,
      answer_as: "rules",
      routes: [get("/api/rules", "The routing rules of links and clients.")]
    }
  end

  @impl true
  def run(_input, %{gateway: gateway}),
    do: {:ok, Object.show(@answer, %{changed: MavRouter.Router.changes(gateway)})}
end
