defmodule Aerie.Config.Keys.Limits do
  @moduledoc "What bounds memory."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `limits`."
  @spec section() :: Field.t()
  def section do
    section(:limits, "What bounds memory when a radio (or somebody) makes vehicles up.", [
      field(:max_vehicles, {:integer, 1, 100_000}, "Vehicles; further ones are counted and ignored.",
        default: 250
      ),
      field(:max_links, {:integer, 1, 10_000}, "Links.", default: 64),
      field(:max_clients, {:integer, 1, 10_000}, "Client endpoints.", default: 64),
      field(:max_peers, {:integer, 1, 100_000}, "Peers of one listening link.", default: 256),
      field(:max_events_in_flight, {:integer, 1, 10_000}, "Events sent to NATS and not yet confirmed.",
        default: 64
      )
    ])
  end
end
