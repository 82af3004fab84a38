defmodule Aerie.Bridge.Metrics do
  @moduledoc "The bridge's counters and gauges with their names, for whoever renders them."

  alias Aerie.Bridge.Tables
  alias Aerie.{Fleet, Names}

  @typedoc "`samples`: value for each set of labels."
  @type metric :: %{
          name: String.t(),
          type: :counter | :gauge,
          help: String.t(),
          samples: [{labels :: [{atom(), String.t()}], number()}]
        }

  @counters [
    published:
      {"gateway_nats_messages_published_total",
       "Messages published to NATS (events: confirmed by the stream)."},
    received: {"gateway_nats_messages_received_total", "Messages received from NATS."},
    publish_errors:
      {"gateway_nats_publish_errors_total",
       "Messages that NATS or the connection refused; they are tried again."},
    state_superseded:
      {"gateway_nats_state_superseded_total",
       "State values replaced by newer ones before they were published."},
    state_dropped:
      {"gateway_nats_state_dropped_total", "State values dropped because there are too many subjects."},
    event_retries: {"gateway_nats_event_retries_total", "Events sent again for want of a confirmation."},
    event_duplicates: {"gateway_nats_event_duplicates_total", "Events that the stream had already."},
    events_dropped: {"gateway_nats_events_dropped_total", "Events that the stream can never take."},
    connects: {"gateway_nats_connects_total", "Connections made to NATS."},
    disconnects: {"gateway_nats_disconnects_total", "Connections to NATS lost."},
    server_restarts: {"gateway_nats_server_restarts_total", "Ends of the embedded NATS server."},
    outbox_written: {"gateway_outbox_events_written_total", "Events written to the outbox."},
    outbox_errors: {"gateway_outbox_write_errors_total", "Failed writes to the outbox."}
  ]

  # Always there, so that a rate over them starts at zero and not at their first failure.
  @unlabelled ~w(publish_errors event_retries event_duplicates events_dropped connects disconnects server_restarts
                 outbox_written outbox_errors)a

  @doc "All of them."
  @spec all(Names.gateway(), Tables.t()) :: [metric()]
  def all(gateway, tables) do
    counted = tables.counters |> :ets.tab2list() |> Enum.group_by(fn {{metric, _labels}, _n} -> metric end)
    Enum.flat_map(@counters, &counter(&1, counted)) ++ gauges(gateway, tables)
  end

  defp counter({key, {name, help}}, counted) do
    samples = for {{^key, labels}, n} <- Map.get(counted, key, []), do: {labels, n}
    samples = if samples == [] and key in @unlabelled, do: [{[], 0}], else: Enum.sort(samples)
    if samples == [], do: [], else: [%{name: name, type: :counter, help: help, samples: samples}]
  end

  defp gauges(gateway, tables) do
    outbox = Tables.info(tables, :outbox)
    connected = if Tables.info(tables, :connection)[:status] == :up, do: 1, else: 0

    [
      {"gateway_nats_connected", :gauge, "1 while there is a connection to NATS.", connected},
      {"gateway_nats_ready", :gauge, "1 while nothing is known that keeps events from being stored by NATS.",
       if(Tables.problem(tables), do: 0, else: 1)},
      {"gateway_events_stalled_seconds", :gauge, "For how long events have waited and none was confirmed.",
       Map.get(outbox, :stalled_s, 0)},
      {"gateway_events_pending", :gauge, "Events in memory, not yet confirmed or on disk.",
       Fleet.Journal.pending_size(gateway)},
      {"gateway_events_in_flight", :gauge, "Events sent and not yet confirmed.",
       Map.get(outbox, :in_flight, 0)},
      {"gateway_outbox_events", :gauge, "Events in the outbox.", Map.get(outbox, :events, 0)},
      {"gateway_outbox_bytes", :gauge, "Bytes of the outbox on disk.", Map.get(outbox, :bytes, 0)},
      {"gateway_outbox_dropped_total", :counter,
       "Events dropped by the outbox for want of room or readability.", Map.get(outbox, :dropped, 0)}
    ]
    |> Enum.map(fn {name, type, help, value} ->
      %{name: name, type: type, help: help, samples: [{[], value}]}
    end)
  end
end
