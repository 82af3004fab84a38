defmodule Aerie.Control.Operations.Files.Read do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Files

  @impl true
  def operation do
    summary = "A file on board; with list, a folder; with crc, its checksum."

    %Operation{
      name: "files.read",
      meaning: "Reads a file on board.",
      fields: [path()],
      answer: %{path: %{type: :string}, data: data()},
      routes: [get("/api/vehicles/:id/files/[...]", summary, media: ["application/octet-stream"])]
    }
  end

  @impl true
  def run(%{path: path}, context) do
    most = if context.max_bytes, do: [max_bytes: context.max_bytes], else: []

    with {:ok, bytes} <- Files.read(context.gateway, context.vehicle, path, most ++ context.options),
         do: {:ok, {:bytes, bytes, path}}
  end
end
