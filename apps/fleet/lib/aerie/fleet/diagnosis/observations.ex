defmodule Aerie.Fleet.Diagnosis.Observations do
  @moduledoc """
  What the rules look at: the read model of this moment, as plain values. Nothing here calls a process that handles frames, or sends
  anything to a vehicle.

  | key | value |
  |---|---|
  | `:now`, `:mono` | unix microseconds, monotonic ms |
  | `:clock_offset` | `Aerie.Base.Timing.HostClock.offset/0` |
  | `:links`, `:vehicles`, `:endpoints` | snapshots (`Aerie.Base.Store.Links`, `Aerie.Base.Store`, `MavRouter.Router.endpoints/1`) |
  | `:clients` | the endpoints for clients (`MavRouter.Client.endpoints/1`) |
  | `:identity` | `MavRouter.Router.identity/1` |
  | `:nats`, `:nats_off?` | `Aerie.Fleet.Bridge.info/1` |
  | `:recorder` | `MavRouter.Recorder.status/1` or nil |
  | `:tracks` | `Aerie.Fleet.Tracks.Metrics.status/1` |
  | `:audit` | why the audit log cannot be written, or nil |
  | `:ledger` | why no command is admitted, or nil (`Aerie.Control.Ledger.problem/1`) |
  | `:damaged` | files that were set aside (`Aerie.Base.Files.Damaged.list/1`) |
  | `:signing` | `MavRouter.Signing.list/1` |

  `Aerie.Fleet.Diagnosis.Trend` adds `:grown`, `:online_ms` and `:clock_steps`.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Timing.HostClock
  alias Aerie.Base.Files.Damaged
  alias Aerie.Control.{Ledger, Policy}
  alias Aerie.Fleet.{Bridge, Tracks}
  alias MavRouter.{Client, Recorder, Router, Signing}

  @type t :: %{atom() => term()}

  @doc "The facts of a gateway now. One that does not run has no links and no vehicles."
  @spec of(Names.gateway()) :: t()
  def of(gateway) do
    %{
      now: System.os_time(:microsecond),
      mono: System.monotonic_time(:millisecond),
      clock_offset: HostClock.offset(),
      links: Store.Links.all(gateway),
      vehicles: Store.vehicles(gateway),
      endpoints: Router.endpoints(gateway),
      clients: Client.endpoints(gateway),
      identity: Router.identity(gateway),
      nats: Bridge.info(gateway),
      nats_off?: Bridge.off?(gateway),
      recorder: Recorder.status(gateway),
      tracks: Tracks.Metrics.status(gateway),
      audit: Policy.Audit.failing(gateway),
      ledger: Ledger.problem(gateway),
      damaged: Damaged.list(gateway),
      signing: Signing.list(gateway)
    }
  end
end
