defmodule Aerie.Control.Operations.Logs.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Logs

  @impl true
  def operation do
    %Operation{
      name: "logs.list",
      meaning: "Lists the logs on board.",
      answer: %{logs: %{type: :array, items: Map.put(log_schema(), :additionalProperties, true)}},
      routes: [get("/api/vehicles/:id/logs", "The logs on board.")]
    }
  end

  @impl true
  def run(_input, context) do
    with {:ok, logs} <- Logs.list(context.gateway, context.vehicle, context.options), do: {:ok, %{logs: logs}}
  end
end
