defmodule Aerie.Api.Rest.Operations.Recordings.Save do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias MavRouter.Recorder

  @impl true
  def operation do
    summary = "Saves the last minutes of a vehicle as a recording."

    %Operation{
      name: "recording.save",
      meaning: "Saves the last minutes of a vehicle.",
      transfer?: false,
      fields: [field(:reason, {:text, 0, 40}, "a part of the file's name", default: "request")],
      answer: %{name: %{type: :string}, url: %{type: :string}},
      routes: [post("/api/vehicles/:id/save", summary, change: :save, status: 201)]
    }
  end

  @impl true
  def run(%{reason: reason}, context) do
    with {:ok, file} <- Recorder.save(context.gateway, context.vehicle, reason) do
      name = Path.basename(file)
      {:ok, %{name: name, url: "/api/recordings/#{name}"}}
    end
  end
end
