defmodule Aerie.FleetParts do
  @moduledoc "What `Aerie.GatewayCase` plugs in of this app."

  @doc "Parts of a test's gateway besides those of vehicles: when it has them, and the part before which it starts (nil: at the end)."
  @spec parts() :: [{:always | :bridge, module(), before :: module() | nil}]
  def parts do
    [
      {:bridge, Aerie.Fleet.Bridge.State.LastPublished, MavRouter.Signing.Supervisor},
      {:bridge, Aerie.Fleet.Bridge.Supervisor, MavRouter.Signing.Supervisor},
      {:always, Aerie.Fleet.Client.Supervisor, nil}
    ]
  end

  @doc "See `Aerie.GatewayCase.plugs/1`."
  @spec plugs(map()) :: keyword()
  def plugs(_config),
    do: [
      tables: Aerie.Fleet.Parts.tables(),
      publisher: Aerie.Fleet.Bridge,
      loops: [Aerie.Fleet.Shadow.Loop]
    ]
end
