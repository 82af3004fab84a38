defmodule Aerie.Telemetry do
  @moduledoc """
  The `:telemetry` events of the gateway.

  Every event has `gateway` in its metadata. Its other metadata and its measurements are in the table of the module that emits
  it, which `events/0` names. The name of a duration says its unit.

  None of these events is emitted per frame. What happens thousands of times a second is counted in the read model
  (`Aerie.Store.counters/1`, snapshots of links and vehicles).

  ## Vehicles

  | event | measurements | metadata | when |
  |---|---|---|---|
  | `[:aerie, :vehicle, :status]` | `count` (1) | `vehicle`, `old`, `new` | it is online, stale or lost |
  | `[:aerie, :vehicle, :event]` | `count` (1) | `vehicle`, `type`, `event` | an `Aerie.Vehicle.Event` was committed |
  | `[:aerie, :vehicle, :displaced]` | `lost_ms` | `vehicle`, `network`, `system`, `by` | it was lost and made room for another vehicle |
  | `[:aerie, :vehicle, :restart]` | `count` (1) | `network`, `system` | a vehicle's process tree died and was restarted |

  ## Links, router, bridge, commands, shadow, ledger, policy and audit log

  See `Aerie.Shadow.Metrics`, `Aerie.Commands.Record`, `Aerie.Ledger`, `Aerie.Policy.Audit`, `Aerie.Policy.Guard`, `Aerie.Link`, `Aerie.Router`, `Aerie.Signing`, `Aerie.Recorder` and `Aerie.Bridge`.

      :telemetry.attach("log-events", [:aerie, :vehicle, :event], &MyLogger.handle/4, nil)
  """

  @events [
    {[:aerie, :vehicle, :status], Aerie.Telemetry},
    {[:aerie, :vehicle, :event], Aerie.Telemetry},
    {[:aerie, :vehicle, :displaced], Aerie.Telemetry},
    {[:aerie, :vehicle, :restart], Aerie.Telemetry},
    {[:aerie, :link, :up], Aerie.Link},
    {[:aerie, :link, :down], Aerie.Link},
    {[:aerie, :link, :ended], Aerie.Link},
    {[:aerie, :link, :peer_up], Aerie.Link},
    {[:aerie, :link, :peer_down], Aerie.Link},
    {[:aerie, :link, :overload], Aerie.Link},
    {[:aerie, :link, :relieved], Aerie.Link},
    {[:aerie, :link, :added], Aerie.Link},
    {[:aerie, :link, :removed], Aerie.Link},
    {[:aerie, :identity, :latched], Aerie.Router.AutoSystemId},
    {[:aerie, :identity, :silent], Aerie.Identity.Watchdog},
    {[:aerie, :identity, :answering], Aerie.Identity.Watchdog},
    {[:aerie, :router, :vehicle_found], Aerie.Router},
    {[:aerie, :router, :vehicle_refused], Aerie.Router},
    {[:aerie, :router, :dropped], Aerie.Router},
    {[:aerie, :router, :denied], Aerie.Router},
    {[:aerie, :router, :reboot], Aerie.Router},
    {[:aerie, :router, :carrier], Aerie.Router},
    {[:aerie, :router, :collision], Aerie.Router},
    {[:aerie, :signing, :alarm], Aerie.Signing},
    {[:aerie, :signing, :enrolled], Aerie.Signing},
    {[:aerie, :signing, :revoked], Aerie.Signing},
    {[:aerie, :signing, :failed], Aerie.Signing},
    {[:aerie, :signing, :not_stored], Aerie.Signing},
    {[:aerie, :recorder, :opened], Aerie.Recorder},
    {[:aerie, :recorder, :closed], Aerie.Recorder},
    {[:aerie, :recorder, :paused], Aerie.Recorder},
    {[:aerie, :recorder, :removed], Aerie.Recorder},
    {[:aerie, :audit, :failing], Aerie.Policy.Audit},
    {[:aerie, :ledger, :failing], Aerie.Ledger},
    {[:aerie, :policy, :refused], Aerie.Policy.Guard},
    {[:aerie, :command, :received], Aerie.Commands.Record},
    {[:aerie, :command, :refused], Aerie.Commands.Record},
    {[:aerie, :command, :done], Aerie.Commands.Record},
    {[:aerie, :shadow, :updated], Aerie.Shadow.Metrics},
    {[:aerie, :shadow, :refused], Aerie.Shadow.Metrics},
    {[:aerie, :shadow, :set], Aerie.Shadow.Metrics},
    {[:aerie, :audit, :writing], Aerie.Policy.Audit},
    {[:aerie, :bridge, :server, :up], Aerie.Bridge},
    {[:aerie, :bridge, :server, :down], Aerie.Bridge},
    {[:aerie, :bridge, :connected], Aerie.Bridge},
    {[:aerie, :bridge, :disconnected], Aerie.Bridge},
    {[:aerie, :bridge, :events, :confirmed], Aerie.Bridge}
  ]

  @doc "All events, each with the module that documents it. A module that adds an event adds it here."
  @spec events() :: [{:telemetry.event_name(), module()}]
  def events, do: @events
end
