defmodule Aerie.Control.Operations.Files.Write do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Files
  alias Aerie.Control.Ftp.Client

  @impl true
  def operation do
    %Operation{
      name: "files.write",
      meaning: "Writes a file on board.",
      changes?: true,
      fields: [path(), base64()],
      routes: [
        put("/api/vehicles/:id/files/[...]", "Writes a file on board.",
          file: :data,
          media: ["application/octet-stream"],
          max_bytes: Client.max_bytes()
        )
      ]
    }
  end

  @impl true
  def run(%{path: path, data: bytes}, context),
    do: Files.write(context.gateway, context.vehicle, path, bytes, context.options)
end
