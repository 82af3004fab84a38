defmodule Aerie.Fleet.Operations.Requests.Readiness do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias Aerie.Fleet.Operations.Readiness
  alias Aerie.Vehicle.Snapshot

  @impl true
  def operation do
    %Operation{
      name: "operation.readiness",
      meaning: "Whether a vehicle is ready to take off, point by point.",
      transfer?: false,
      fields: [field(:vehicle, :token, "its id; over REST it is in the path")],
      answer: Snapshot.readiness_fields(),
      routes: [
        get("/api/vehicles/:id/readiness", "Whether it is ready to take off, point by point.",
          omit: [:vehicle]
        )
      ]
    }
  end

  @impl true
  def run(input, context) do
    id = input[:vehicle] || context.vehicle
    viewer = if context.source, do: context.source.name, else: :anybody

    case Readiness.of(context.gateway, id, viewer) do
      nil -> {:error, {:unknown, "there is no vehicle #{id}"}}
      readiness -> {:ok, Object.show(Snapshot.readiness_fields(), readiness)}
    end
  end
end
