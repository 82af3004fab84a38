defmodule Aerie.Control.Operations.Files.Remove do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Files

  @impl true
  def operation do
    %Operation{
      name: "files.remove",
      meaning: "Removes a file on board.",
      changes?: true,
      fields: [path()],
      routes: [delete("/api/vehicles/:id/files/[...]", "Removes a file on board.")]
    }
  end

  @impl true
  def run(%{path: path}, context), do: Files.remove(context.gateway, context.vehicle, path, context.options)
end
