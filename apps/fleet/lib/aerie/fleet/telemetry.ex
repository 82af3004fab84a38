defmodule Aerie.Fleet.Telemetry do
  @moduledoc """
  The `:telemetry` events of the gateway.

  Every event has `gateway` in its metadata. Its other metadata and its measurements are in the table of the module that emits
  it, which `events/0` names. The name of a duration says its unit.

  None of these events is emitted per frame. What happens thousands of times a second is counted in the read model
  (`Aerie.Base.Store.counters/1`, snapshots of links and vehicles).

  ## Vehicles

  | event | measurements | metadata | when |
  |---|---|---|---|
  | `[:aerie, :vehicle, :status]` | `count` (1) | `vehicle`, `old`, `new` | it is online, stale or lost |
  | `[:aerie, :vehicle, :event]` | `count` (1) | `vehicle`, `type`, `event` | an `Aerie.Vehicle.Event` was committed |
  | `[:aerie, :vehicle, :displaced]` | `lost_ms` | `vehicle`, `network`, `system`, `by` | it was lost and made room for another vehicle |
  | `[:aerie, :vehicle, :restart]` | `count` (1) | `network`, `system` | a vehicle's process tree died and was restarted |

  ## Links, router, bridge, commands, shadow, tracks, ledger, policy and audit log

  See `Aerie.Fleet.Shadow.Metrics`, `Aerie.Fleet.Tracks.Metrics`, `Aerie.Control.Commands.Record`, `Aerie.Control.Ledger`, `Aerie.Control.Policy.Audit`, `Aerie.Control.Policy.Clients.MavlinkPolicy`, `MavRouter.Link`, `MavRouter.Router`, `MavRouter.Signing`, `MavRouter.Recorder` and `Aerie.Fleet.Bridge`.

      :telemetry.attach("log-events", [:aerie, :vehicle, :event], &MyLogger.handle/4, nil)
  """

  @events [
    {[:aerie, :vehicle, :status], Aerie.Fleet.Telemetry},
    {[:aerie, :vehicle, :event], Aerie.Fleet.Telemetry},
    {[:aerie, :vehicle, :displaced], Aerie.Fleet.Telemetry},
    {[:aerie, :vehicle, :restart], Aerie.Fleet.Telemetry},
    {[:aerie, :link, :up], MavRouter.Link},
    {[:aerie, :link, :down], MavRouter.Link},
    {[:aerie, :link, :ended], MavRouter.Link},
    {[:aerie, :link, :peer_up], MavRouter.Link},
    {[:aerie, :link, :peer_down], MavRouter.Link},
    {[:aerie, :link, :overload], MavRouter.Link},
    {[:aerie, :link, :relieved], MavRouter.Link},
    {[:aerie, :link, :added], MavRouter.Link},
    {[:aerie, :link, :removed], MavRouter.Link},
    {[:aerie, :identity, :latched], MavRouter.Router.AutoSystemId},
    {[:aerie, :identity, :silent], MavRouter.Identity.Watchdog},
    {[:aerie, :identity, :answering], MavRouter.Identity.Watchdog},
    {[:aerie, :router, :vehicle_found], MavRouter.Router},
    {[:aerie, :router, :vehicle_refused], MavRouter.Router},
    {[:aerie, :router, :dropped], MavRouter.Router},
    {[:aerie, :router, :denied], MavRouter.Router},
    {[:aerie, :router, :reboot], MavRouter.Router},
    {[:aerie, :router, :carrier], MavRouter.Router},
    {[:aerie, :router, :collision], MavRouter.Router},
    {[:aerie, :signing, :alarm], MavRouter.Signing},
    {[:aerie, :signing, :enrolled], MavRouter.Signing},
    {[:aerie, :signing, :revoked], MavRouter.Signing},
    {[:aerie, :signing, :failed], MavRouter.Signing},
    {[:aerie, :signing, :not_stored], MavRouter.Signing},
    {[:aerie, :recorder, :opened], MavRouter.Recorder},
    {[:aerie, :recorder, :closed], MavRouter.Recorder},
    {[:aerie, :recorder, :paused], MavRouter.Recorder},
    {[:aerie, :recorder, :removed], MavRouter.Recorder},
    {[:aerie, :audit, :failing], Aerie.Control.Policy.Audit},
    {[:aerie, :ledger, :failing], Aerie.Control.Ledger},
    {[:aerie, :policy, :refused], Aerie.Control.Policy.Clients.MavlinkPolicy},
    {[:aerie, :command, :received], Aerie.Control.Commands.Record},
    {[:aerie, :command, :refused], Aerie.Control.Commands.Record},
    {[:aerie, :command, :done], Aerie.Control.Commands.Record},
    {[:aerie, :shadow, :updated], Aerie.Fleet.Shadow.Metrics},
    {[:aerie, :shadow, :refused], Aerie.Fleet.Shadow.Metrics},
    {[:aerie, :shadow, :set], Aerie.Fleet.Shadow.Metrics},
    {[:aerie, :tracks, :failing], Aerie.Fleet.Tracks.Metrics},
    {[:aerie, :audit, :writing], Aerie.Control.Policy.Audit},
    {[:aerie, :bridge, :server, :up], Aerie.Fleet.Bridge},
    {[:aerie, :bridge, :server, :down], Aerie.Fleet.Bridge},
    {[:aerie, :bridge, :connected], Aerie.Fleet.Bridge},
    {[:aerie, :bridge, :disconnected], Aerie.Fleet.Bridge},
    {[:aerie, :bridge, :events, :confirmed], Aerie.Fleet.Bridge}
  ]

  @doc "All events, each with the module that documents it. A module that adds an event adds it here."
  @spec events() :: [{:telemetry.event_name(), module()}]
  def events, do: @events
end
