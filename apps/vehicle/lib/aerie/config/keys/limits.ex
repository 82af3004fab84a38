defmodule Aerie.Config.Keys.Limits do
  @moduledoc "What bounds memory."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `limits`."
  @spec section() :: Field.t()
  def section do
    section(:limits, "What bounds memory when a radio (or somebody) makes vehicles up.", [
      field(
        :max_vehicles,
        {:integer, 1, 100_000},
        """
        Vehicles. A further one takes the place of the one that is lost for the longest time, or is counted and ignored.
        """,
        default: 600
      ),
      field(
        :displace_lost_s,
        {:number, 0, 604_800},
        """
        How long a vehicle must be lost before one that was never here takes its place; one that was, or that has a name
        here, need not wait. The place of a vehicle with a name (vehicles, vehicle_id) is nobody else's.
        """,
        default: 60.0
      ),
      field(:max_links, {:integer, 1, 10_000}, "Links.", default: 64),
      field(:max_clients, {:integer, 1, 10_000}, "Client endpoints.", default: 64),
      field(:max_peers, {:integer, 1, 100_000}, "Peers of one listening link.", default: 1024),
      field(:max_events_in_flight, {:integer, 1, 10_000}, "Events sent to NATS and not yet confirmed.",
        default: 64
      ),
      field(
        :max_pending_events,
        {:integer, 100, 10_000_000},
        "Events in memory, neither confirmed by NATS nor on disk; the oldest go first, and are counted.",
        default: 20_000
      )
    ])
  end
end
