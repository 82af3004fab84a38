defmodule Aerie.ControlParts do
  @moduledoc "What `Aerie.GatewayCase` plugs in of this app."

  @doc "See `Aerie.FleetParts.parts/0`; a test starts what it needs of this app."
  @spec parts() :: []
  def parts, do: []

  @doc "See `Aerie.GatewayCase.plugs/1`."
  @spec plugs(map()) :: keyword()
  def plugs(_config) do
    [
      tables: [Aerie.Commands.Recent.table(), Aerie.Policy.Leases.table()],
      policy: Aerie.Policy.Guard,
      readings: Aerie.Serving,
      arming: Aerie.Policy.Arming,
      loops: [Aerie.Vehicle.Commands, Aerie.Vehicle.Transfers]
    ]
  end
end
