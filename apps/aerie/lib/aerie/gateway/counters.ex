defmodule Aerie.Gateway.Counters do
  @moduledoc """
  The counters of the read model that a gateway has from its start, with 0, so that `rate()` and `increase()` see their first event. Those with a
  name from outside (a subject of NATS, a message, a vehicle) appear when it does.
  """

  alias Aerie.Control.{Commands, Policy}

  # The interface, and why a client was refused or disconnected.
  @clients for(why <- [:malformed, :stalled, :refused], do: {:clients, :mavlink, why}) ++
             for(why <- [:chatter, :stalled, :refused], do: {:clients, :state, why}) ++
             [{:clients, :websocket, :text}]

  @drops [
    {:console, :launched},
    {:console, :limited},
    {:console, :refused},
    {:console, :signed_in},
    {:console, :unknown_proxy},
    {:identity, :held},
    {:identity, :withheld},
    {:journal, :inbox_dropped},
    {:journal, :params_dropped},
    {:journal, :pending_dropped},
    {:output, :lines_lost},
    {:params, :not_kept},
    {:recorder, :not_saved},
    {:stations, :dropped},
    {:streams, :absorbed},
    {:vehicles, :displaced},
    {:vehicles, :refused},
    {:vehicles, :tree_restarts},
    {:wants, :refused},
    :served_messages
  ]

  @doc "All of them."
  @spec all() :: [term()]
  def all,
    do:
      Policy.counters() ++
        Commands.Metrics.counters() ++ Aerie.Fleet.Tracks.Metrics.counters() ++ @clients ++ @drops
end
