defmodule Aerie.Control.Operations.Mission.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Missions
  alias Aerie.Control.Operations.Mission.Forms

  @impl true
  def operation do
    %Operation{
      name: "mission.get",
      meaning: "Reads the mission, the fence or the rally points.",
      fields: [kind()],
      answer: answer(),
      routes: Forms.routes(&route/3)
    }
  end

  defp route(path, name, options) do
    media = ["text/plain", "application/octet-stream"]
    get(path, "Reads the #{name} of a vehicle.", [media: media] ++ options)
  end

  defp answer do
    remarks = "what QGroundControl would not read of the plan"

    %{
      kind: %{enum: Missions.kinds()},
      items: count(),
      digest: described(%{type: :string}, "of the content"),
      opaque_id: described(%{type: [:integer, :null]}, "the vehicle's own id of it"),
      remarks: described(%{type: :array, items: %{type: :string}}, remarks),
      plan: ref("plan")
    }
  end

  @impl true
  def run(%{kind: kind}, context) do
    with {:ok, stored} <- Missions.download(context.gateway, context.vehicle, kind, context.options),
         do: Forms.write(context.format, stored, kind, context.vehicle)
  end
end
