defmodule Aerie.Fleet.Bridge.Metrics do
  @moduledoc "The bridge's metrics, to be rendered."

  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.Names

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
       "Messages that NATS or the connection refused; they are sent again."},
    state_superseded:
      {"gateway_nats_state_superseded_total",
       "State values replaced by newer ones before they were published."},
    state_dropped:
      {"gateway_nats_state_dropped_total", "State values dropped because there are too many subjects."},
    event_retries: {"gateway_nats_event_retries_total", "Events sent again because no confirmation came."},
    event_duplicates: {"gateway_nats_event_duplicates_total", "Events that the stream already had."},
    events_dropped:
      {"gateway_nats_events_dropped_total", "Events dropped because the stream can never take them."},
    commands_dropped:
      {"gateway_nats_commands_dropped_total", "Commands dropped because too many came at once."},
    commands_unread:
      {"gateway_nats_commands_unread_total",
       "Requests without the signature of a listed key that were not answered, because more of them came than are answered."},
    connects: {"gateway_nats_connects_total", "Connections made to NATS."},
    disconnects: {"gateway_nats_disconnects_total", "Connections to NATS lost."},
    server_restarts: {"gateway_nats_server_restarts_total", "Restarts of the embedded NATS server."},
    hub_events:
      {"gateway_hub_events_confirmed_total", "Events that the hub's stream has confirmed (leaf node)."},
    outbox_written: {"gateway_outbox_events_written_total", "Events written to the outbox."},
    outbox_errors: {"gateway_outbox_write_errors_total", "Failed writes to the outbox."}
  ]

  # Always present, so that a rate starts at zero and not at the first failure.
  @unlabelled ~w(publish_errors event_retries event_duplicates events_dropped commands_dropped commands_unread connects disconnects server_restarts
                 outbox_written outbox_errors)a

  @doc "All of them; without samples if there are no tables, because no bridge runs."
  @spec all(Names.gateway(), Tables.t() | nil) :: [metric()]
  def all(_gateway, nil) do
    counters = for {_key, {name, help}} <- @counters, do: {name, :counter, help}
    for {name, type, help} <- counters ++ gauges(), do: %{name: name, type: type, help: help, samples: []}
  end

  def all(gateway, tables) do
    counted = tables.counters |> :ets.tab2list() |> Enum.group_by(fn {{metric, _labels}, _n} -> metric end)
    Enum.flat_map(@counters, &counter(&1, counted)) ++ gauges(gateway, tables)
  end

  defp counter({key, {name, help}}, counted) do
    samples = for {{^key, labels}, n} <- Map.get(counted, key, []), do: {labels, n}
    samples = if samples == [] and key in @unlabelled, do: [{[], 0}], else: Enum.sort(samples)
    [%{name: name, type: :counter, help: help, samples: samples}]
  end

  defp gauges do
    [
      {"gateway_nats_connected", :gauge, "1 while there is a connection to NATS."},
      {"gateway_nats_ready", :gauge, "1 while NATS stores events, as far as is known."},
      {"gateway_events_stalled_seconds", :gauge, "How long events have waited without any confirmation."},
      {"gateway_events_pending", :gauge, "Events in memory, not yet confirmed or on disk."},
      {"gateway_events_in_flight", :gauge, "Events sent and not yet confirmed."},
      {"gateway_outbox_events", :gauge, "Events in the outbox."},
      {"gateway_outbox_bytes", :gauge, "Bytes of the outbox on disk."},
      {"gateway_outbox_dropped_total", :counter,
       "Events dropped by the outbox because it was full or unreadable."},
      {"gateway_hub_connected", :gauge, "1 while the hub answers (leaf node)."},
      {"gateway_hub_events_waiting", :gauge, "Events in the local stream that the hub does not have."},
      {"gateway_hub_events_lost_total", :counter,
       "Events that the local stream dropped before the hub had them."}
    ]
  end

  # In the order of the table above.
  defp gauges(gateway, tables) do
    outbox = Tables.info(tables, :outbox)

    values = [
      if(Tables.info(tables, :connection)[:status] == :up, do: 1, else: 0),
      if(Tables.problem(tables), do: 0, else: 1),
      Map.get(outbox, :stalled_s, 0),
      Journal.pending_size(gateway),
      Map.get(outbox, :in_flight, 0),
      Map.get(outbox, :events, 0),
      Map.get(outbox, :bytes, 0),
      Map.get(outbox, :dropped, 0)
      | hub(Tables.info(tables, :hub))
    ]

    for {{name, type, help}, value} <- Enum.zip(gauges(), values),
        do: %{name: name, type: type, help: help, samples: if(value, do: [{[], value}], else: [])}
  end

  # Without a hub there is nothing to say of it.
  defp hub(%{status: status, waiting: waiting, lost: lost}),
    do: [if(status == :up, do: 1, else: 0), waiting, lost]

  defp hub(_none), do: [nil, nil, nil]
end
