defmodule Aerie.Control.Operations.Files.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Files

  @impl true
  def operation do
    %Operation{
      name: "files.list",
      meaning: "Lists a folder on board.",
      fields: [path()],
      answer: %{path: %{type: :string}, entries: %{type: :array, maxItems: 10_000, items: entry()}},
      routes: [get("/api/vehicles/:id/files/[...]", "Lists a folder.", select: "list")]
    }
  end

  defp entry do
    properties = %{kind: %{enum: ~w(file directory)}, name: %{type: :string}, size: nullable(count())}
    object(properties, [:kind, :name, :size], open: true)
  end

  @impl true
  def run(%{path: path}, context) do
    with {:ok, entries} <- Files.list(context.gateway, context.vehicle, path, context.options),
         do: {:ok, %{path: path, entries: entries}}
  end
end
