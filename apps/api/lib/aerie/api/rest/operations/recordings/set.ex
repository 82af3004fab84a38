defmodule Aerie.Api.Rest.Operations.Recordings.Set do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias MavRouter.Recorder

  @answer Object.fields([{:recording, {:object, Recorder.fields()}, nil, "its state; null: it is off"}])

  @impl true
  def operation do
    %Operation{
      name: "recording.set",
      meaning: "Starts or stops recording a link or vehicle.",
      transfer?: false,
      fields: [
        field(:id, {:term, &{:ok, &1}, "the id of a link"}, "the link"),
        field(:mode, {:enum, [:always, :armed, :off]}, "when it is recorded", required: true)
      ],
      answer: @answer,
      routes: [
        put("/api/links/:id/recording", "Starts or stops recording a link.", change: :record_link),
        put("/api/vehicles/:id/recording", "Starts or stops recording a vehicle.",
          change: :record_vehicle,
          omit: [:id]
        )
      ]
    }
  end

  @impl true
  def run(%{id: link, mode: mode}, %{gateway: gateway, vehicle: vehicle}) do
    target = if link, do: {:link, link}, else: {:vehicle, vehicle}

    with :ok <- change(gateway, target, mode),
         do: {:ok, Object.show(@answer, %{recording: Recorder.status(gateway, target)})}
  end

  defp change(gateway, target, :off), do: Recorder.stop(gateway, target)
  defp change(gateway, target, mode), do: Recorder.start(gateway, target, mode)
end
