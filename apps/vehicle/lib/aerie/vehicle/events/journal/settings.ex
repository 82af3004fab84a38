defmodule Aerie.Vehicle.Events.Journal.Settings do
  @moduledoc "What bounds the journal of events."
  use Aerie.Base.Settings

  section "limits"

  setting :max_pending_events,
          {:integer, 100, 10_000_000},
          "Events in memory, neither confirmed by the NATS server nor on disk; the oldest go first, and are counted.",
          default: 20_000
end
