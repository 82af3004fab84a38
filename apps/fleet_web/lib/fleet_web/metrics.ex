defmodule FleetWeb.Metrics do
  @moduledoc """
  All metric families of a gateway, read from the read model at the time of the scrape.

  | family | labels | meaning |
  |---|---|---|
  | `gateway_mavlink_messages_received_total` | `type` | good frames received, by message name in lower case |
  | `gateway_mavlink_messages_sent_total` | `type` | messages the gateway itself sent |
  | `gateway_mavlink_parse_errors_total` | | frames with a wrong CRC or unknown incompatibility flags |
  | `gateway_clients`, `gateway_client_*` | `kind` | clients that are connected, and their frames |
  | `gateway_api_requests_total` | `status` | requests to `/api` |
  | `gateway_clients_refused_total` | `face`, `reason` | clients refused or disconnected |
  | `gateway_nats_*` | | see `Aerie.Bridge.metrics/1` |
  | `gateway_recorder_*` | `recording` | see `Aerie.Recorder.metrics/1` |
  | `gateway_link_*` | `link`, `network` | one link: state, bytes, frames, errors, loss, drops, reconnects |
  | `gateway_vehicle_*` | `vehicle` | one vehicle: heard, armed, in air, battery, links |
  | `gateway_counter_total` | `name` | the read model's other counters: drops and refusals |
  | `gateway_vm_*` | | memory, processes and run queue of the VM |

  Message names come from the dialects. An id that no dialect knows is `type="unknown"`, so that received garbage does not
  add time series.
  """

  alias Aerie.Store
  alias FleetWeb.Metrics.{Clients, Links, Text, Vehicles}

  @doc "The metric families of a gateway; those of parts that do not run are empty."
  @spec families(term()) :: [Text.family()]
  def families(gateway) do
    links = Aerie.Link.list(gateway)
    counters = Store.counters(gateway)

    Links.families(links) ++
      Vehicles.families(Store.vehicles(gateway), links, System.os_time(:microsecond)) ++
      bridge(gateway) ++
      Clients.families(Aerie.Client.list(gateway), counters) ++ [sent(counters), others(counters)] ++ vm()
  end

  defp bridge(gateway) do
    for %{name: name, type: type, help: help, samples: samples} <-
          Aerie.Bridge.metrics(gateway) ++ Aerie.Recorder.metrics(gateway) do
      {name, type, help, samples}
    end
  end

  defp sent(counters) do
    samples = for {{:sent, id}, n} <- counters, is_integer(id), do: {Links.message_name(id), n}

    {"gateway_mavlink_messages_sent_total", :counter, "Messages that the gateway itself sent.",
     samples |> sum_by_name() |> Enum.map(fn {name, n} -> {[type: name], n} end)}
  end

  defp others(counters) do
    samples =
      for {name, n} <- counters,
          not match?({:sent, _id}, name) and not Clients.own?(name),
          do: {[name: counter_name(name)], n}

    {"gateway_counter_total", :counter, "Drops and refusals, by name.", Enum.sort(samples)}
  end

  defp counter_name(name) when is_tuple(name),
    do: name |> Tuple.to_list() |> Enum.map_join(".", &counter_name/1)

  defp counter_name(name) when is_atom(name) or is_binary(name) or is_integer(name), do: to_string(name)
  defp counter_name(name), do: inspect(name, limit: 5, printable_limit: 100)

  defp sum_by_name(samples) do
    samples |> Enum.reduce(%{}, fn {name, n}, sums -> Map.update(sums, name, n, &(&1 + n)) end) |> Enum.sort()
  end

  defp vm do
    memory = :erlang.memory()

    [
      {"gateway_vm_memory_bytes", :gauge, "Memory of the VM by kind.",
       for(kind <- [:total, :processes, :binary, :ets, :code], do: {[kind: kind], memory[kind]})},
      {"gateway_vm_processes", :gauge, "Processes of the VM.", [{[], :erlang.system_info(:process_count)}]},
      {"gateway_vm_run_queue", :gauge, "Processes that wait for a processor.",
       [{[], :erlang.statistics(:run_queue)}]},
      {"gateway_vm_atoms", :gauge, "Atoms of the VM: constant in operation.",
       [{[], :erlang.system_info(:atom_count)}]}
    ]
  end
end
