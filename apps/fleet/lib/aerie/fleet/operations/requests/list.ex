defmodule Aerie.Fleet.Operations.Requests.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Operations.Schema

  @impl true
  def operation do
    %Operation{
      name: "operation.list",
      meaning: "All operations, without their vehicles.",
      transfer?: false,
      answer: %{operations: %{type: :array, items: one()}},
      routes: [get("/api/operations", "Operations on many vehicles, without their vehicles.")]
    }
  end

  defp one do
    properties = Schema.operation(false)
    object(properties, Map.keys(properties), open: true)
  end

  @impl true
  def run(_input, context), do: {:ok, %{"operations" => Operations.list(context.gateway)}}
end
