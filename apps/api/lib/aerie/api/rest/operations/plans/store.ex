defmodule Aerie.Api.Rest.Operations.Plans.Store do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Access.HTTP.Error
  alias Aerie.Access.WorkLimit
  alias Aerie.Base.Json.Object
  alias Aerie.Fleet.Shadow

  @impl true
  def operation do
    %Operation{
      name: "plan.store",
      meaning: "Stores a .plan file for desired states.",
      transfer?: false,
      fields: [
        field(:plan, {:term, &{:ok, &1}, "a .plan file"}, "the file", required: true, schema: ref("plan"))
      ],
      answer: Object.fields([{:plan, :text, nil, "its hash, by which a desired state names it"}]),
      routes: [
        post("/api/plans", "Stores a .plan file for desired states.",
          change: :store_plan,
          file: :plan,
          media: ["application/json", "text/plain", "application/octet-stream"],
          max_bytes: Shadow.max_plan_bytes(),
          status: 201
        )
      ]
    }
  end

  # Files that are parsed cost more than a request.
  @impl true
  def run(%{plan: text}, %{gateway: gateway, source: source}) do
    work = fn -> Shadow.put_plan(gateway, text, source) end

    case WorkLimit.run(gateway, :parse, {:name, source.name}, work) do
      {:ok, {:ok, hash}} -> {:ok, %{plan: hash}}
      {:ok, {:error, refusal}} -> {:error, refusal}
      {:busy, seconds} -> {:error, Error.busy(seconds)}
    end
  end
end
