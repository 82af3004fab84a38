defmodule Aerie.Control.Operations.Params.Set do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Params

  @impl true
  def operation do
    %Operation{
      name: "params.set",
      meaning: "Sets one parameter.",
      changes?: true,
      fields: [param_name(), value(), component()],
      rules: [anyOf: [of_autopilot(), of_component()]],
      routes: [put("/api/vehicles/:id/params/:name", "Sets a parameter.", query: [:component])]
    }
  end

  # Whether it suits depends on the component, and on the parameter's type there.
  defp value do
    check = &if(is_number(&1) or is_binary(&1), do: {:ok, &1}, else: :error)
    meaning = "the new value; text only of a component"
    schema = %{type: [:number, :string]}
    field(:value, {:term, check, "a number"}, meaning, required: true, schema: schema)
  end

  defp of_autopilot, do: %{properties: %{component: %{type: :null}, value: float32()}}

  defp of_component do
    text = %{type: :string, maxLength: 45}
    properties = %{component: %{type: :integer}, value: %{anyOf: [%{type: :number}, text]}}
    %{required: [:component], properties: properties}
  end

  @impl true
  def run(input, context) do
    Params.set(context.gateway, context.vehicle, input.name, input.value, context.options)
  end
end
