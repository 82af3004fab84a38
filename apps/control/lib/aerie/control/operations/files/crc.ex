defmodule Aerie.Control.Operations.Files.Crc do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Files

  @impl true
  def operation do
    %Operation{
      name: "files.crc",
      meaning: "The checksum of a file on board.",
      fields: [path()],
      answer: %{path: %{type: :string}, crc32: integer(0, 0xFFFFFFFF)},
      routes: [get("/api/vehicles/:id/files/[...]", "Gives the checksum.", select: "crc")]
    }
  end

  @impl true
  def run(%{path: path}, context) do
    with {:ok, crc} <- Files.crc(context.gateway, context.vehicle, path, context.options),
         do: {:ok, %{path: path, crc32: crc}}
  end
end
