defmodule Aerie.ControlParts do
  @moduledoc "What `Aerie.GatewayCase` plugs in of this app."

  @doc "See `Aerie.FleetParts.parts/0`; a test starts what it needs of this app."
  @spec parts() :: []
  def parts, do: []

  @doc "See `Aerie.GatewayCase.plugs/1`."
  @spec plugs(map()) :: keyword()
  def plugs(_config) do
    [
      tables: [
        Aerie.Control.Commands.Recent.table(),
        Aerie.Control.Policy.ControlLease.Holders.table(),
        Aerie.Control.Policy.Memory.ClientHistory.table()
      ],
      policy: Aerie.Control.Policy.Clients.MavlinkPolicy,
      readings: Aerie.Control.ReadCache,
      arming: Aerie.Control.Policy.Clients.Arming,
      loops: [Aerie.Control.CommandExecutor, Aerie.Control.TransferExecutor]
    ]
  end
end
