defmodule Aerie.Control.Operations.Mission.Clear do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Missions
  alias Aerie.Control.Operations.Mission.Forms

  @impl true
  def operation do
    %Operation{
      name: "mission.clear",
      meaning: "Clears the mission, the fence or the rally points.",
      changes?: true,
      fields: [kind()],
      routes: Forms.routes(&delete(&1, "Clears the #{&2} of a vehicle.", given: &3[:given]))
    }
  end

  @impl true
  def run(%{kind: kind}, context), do: Missions.clear(context.gateway, context.vehicle, kind, context.options)
end
