defmodule Aerie.Control.Operations.Params.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Params
  alias Aerie.Control.Params.Table
  alias Aerie.Vehicle.Command.Error

  @formats %{"param" => :param, "params" => :params, "txt" => :txt}

  @impl true
  def operation do
    %Operation{
      name: "params.list",
      meaning: "Lists all parameters.",
      fields: [component()],
      answer: %{
        count: count(),
        params: %{type: :array, items: object(param(), [:name, :value, :type], open: true)}
      },
      routes: [
        get("/api/vehicles/:id/params", "All parameters of a vehicle.",
          formats: ["json" | Enum.sort(Map.keys(@formats))],
          media: ["text/plain"]
        )
      ]
    }
  end

  @impl true
  def run(_input, %{format: "json"} = context) do
    with {:ok, table} <- Params.list(context.gateway, context.vehicle, context.options),
         do: {:ok, Table.plain(table)}
  end

  # Files of parameters have only numbers, as autopilots do.
  def run(%{component: nil}, context) do
    format = Map.fetch!(@formats, context.format)

    with {:ok, text} <- Params.save(context.gateway, context.vehicle, format, context.options),
         do: {:ok, {:file, "#{context.vehicle}.#{context.format}", text}}
  end

  def run(input, _context) do
    expected = "nothing: only the list as JSON and single parameters have it"
    {:error, [Error.new("component", expected, input.component)]}
  end
end
