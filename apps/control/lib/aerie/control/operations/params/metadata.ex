defmodule Aerie.Control.Operations.Params.Metadata do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Params

  @impl true
  def operation do
    %Operation{
      name: "params.metadata",
      meaning: "What the vehicle says of its parameters.",
      fields: [names()],
      answer: %{params: %{type: :array, items: object(%{name: %{type: :string}}, [:name], open: true)}},
      routes: [
        get("/api/vehicles/:id/metadata/params", "What the vehicle itself says of its parameters.",
          omit: [:names]
        )
      ]
    }
  end

  # All of them may be more than a message of NATS carries.
  defp names do
    field(:names, {:list, {:text, 1, 64}}, "which; all if left out")
  end

  @impl true
  def run(input, context) do
    with {:ok, all} <- Params.metadata(context.gateway, context.vehicle, context.options),
         do: {:ok, %{params: for(name <- input.names || Enum.sort(Map.keys(all)), one = all[name], do: one)}}
  end
end
