defmodule Aerie.Control.Operations.Params.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Params
  alias Aerie.Control.Params.Param

  @impl true
  def operation do
    %Operation{
      name: "params.get",
      meaning: "Reads one parameter.",
      fields: [param_name(), component()],
      answer: param(),
      routes: [get("/api/vehicles/:id/params/:name", "One parameter.")]
    }
  end

  @impl true
  def run(input, context) do
    with {:ok, param} <- Params.get(context.gateway, context.vehicle, input.name, context.options),
         do: {:ok, Param.plain(param)}
  end
end
