defmodule Aerie.Api.Metrics.Page do
  @moduledoc """
  `docs/metrics.md`, made from the families of `Aerie.Api.Metrics` (`mix aerie.metrics`), so that the page cannot differ from what
  `/metrics` answers.
  """

  alias Aerie.Api.Metrics

  # By the beginning of the name; the first match counts.
  @sections [
    {"gateway_mavlink_", "MAVLink"},
    {"gateway_link_", "Links"},
    {"gateway_vehicle", "Vehicles"},
    {"gateway_command", "Commands"},
    {"gateway_policy_", "Policy and audit log"},
    {"gateway_audit_", "Policy and audit log"},
    {"gateway_shadow_", "Desired states"},
    {"gateway_nats_", "NATS, events and the outbox"},
    {"gateway_events_", "NATS, events and the outbox"},
    {"gateway_outbox_", "NATS, events and the outbox"},
    {"gateway_recorder_", "Recorder"},
    {"gateway_client", "Clients and REST"},
    {"gateway_api_", "Clients and REST"},
    {"gateway_", "The gateway itself"}
  ]

  # The labels of a family, by the beginning of its name; the first that fits.
  @labels [
    {"gateway_mavlink_messages_", [:type]},
    {"gateway_link_dropped_total", [:link, :network, :reason]},
    {"gateway_link_", [:link, :network]},
    {"gateway_vehicle_", [:vehicle]},
    {"gateway_commands_received_total", [:type]},
    {"gateway_commands_executed_total", [:type, :result]},
    {"gateway_commands_refused_total", [:type, :rule]},
    {"gateway_command_latency_seconds", [:type]},
    {"gateway_policy_decisions_total", [:decision, :rule]},
    {"gateway_shadow_fields", [:state]},
    {"gateway_nats_messages_", [:subject]},
    {"gateway_nats_state_", [:subject]},
    {"gateway_recorder_free", []},
    {"gateway_recorder_frames", [:recording]},
    {"gateway_recorder_bytes", [:recording]},
    {"gateway_recorder_files", [:recording]},
    {"gateway_recorder_dropped", [:recording]},
    {"gateway_recorder_errors", [:recording]},
    {"gateway_clients_refused_total", [:interface, :reason]},
    {"gateway_client_unread_datagrams", [:reason]},
    {"gateway_client_endpoints_overloaded", []},
    {"gateway_client", [:kind]},
    {"gateway_api_requests_total", [:status]},
    {"gateway_occurrences_total", [:name]},
    {"gateway_vm_memory_bytes", [:kind]}
  ]

  @doc "All families that a gateway can have: name, type, meaning."
  @spec known() :: [{String.t(), atom(), String.t()}]
  def known do
    # One that does not run has all of them, without samples.
    for {name, type, help, _samples} <- Metrics.families(make_ref()), do: {name, type, help}
  end

  @doc "The labels of a family."
  @spec labels(String.t()) :: [atom()]
  def labels(name), do: first(@labels, name) || []

  @doc "The text of the page."
  @spec markdown() :: String.t()
  def markdown do
    sections = @sections |> Enum.map(&elem(&1, 1)) |> Enum.uniq()
    families = Enum.group_by(known(), fn {name, _type, _help} -> first(@sections, name) end)
    IO.iodata_to_binary([intro() | Enum.map(sections, &section(&1, families[&1] || []))])
  end

  defp first(table, name) do
    Enum.find_value(table, fn {beginning, value} -> if String.starts_with?(name, beginning), do: value end)
  end

  defp intro do
    """
    # Metrics: every family, its labels, its meaning

    <!-- Made by `mix aerie.metrics` from Aerie.Api.Metrics: change that, not this page. -->

    `GET /metrics` answers in Prometheus' text format, on the port of the console (`http.port`). It needs no key, but a `Host`
    that belongs to the gateway ([clients.md](clients.md#who-may-do-what)). A scrape reads what the gateway knows anyway: it waits for no
    vehicle, link or disk.

    - A value that is not known is left out, because a made-up zero would look like a measurement.
    - Counters are there with 0 from the gateway's start, so that `rate()` sees their first event. Those by message, subject, recording or
      status, and `gateway_commands_refused_total`, begin with their first event; those of links and vehicles with the link or vehicle.
    - The label `type` of an unknown message is `unknown`, so garbage adds no time series. Clients are summed by `kind`: they come and go.

    A dashboard for Grafana and alert rules for Prometheus are in
    [rel/overlays/monitoring](../rel/overlays/monitoring/README.md).
    """
  end

  defp section(_title, []), do: []

  defp section(title, families) do
    rows =
      for {name, type, help} <- Enum.sort(families) do
        labels = Enum.map_join(labels(name), ", ", &"`#{&1}`")
        "| `#{name}` | #{type} | #{labels} | #{help} |\n"
      end

    ["\n## ", title, "\n\n| family | type | labels | meaning |\n|---|---|---|---|\n", rows]
  end
end
