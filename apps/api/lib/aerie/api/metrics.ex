defmodule Aerie.Api.Metrics do
  @moduledoc """
  All metric families of a gateway, read from the read model at the time of the scrape.

  `docs/metrics.md` lists them (`Aerie.Api.Metrics.Page`).

  Message names come from the dialects. An id that no dialect knows is `type="unknown"`, so that received garbage does not
  add time series.
  """

  alias Aerie.Base.Store
  alias Aerie.Control.Commands
  alias Aerie.Fleet.Shadow
  alias Aerie.Api.Metrics.{Clients, Links, Policy, Text, Vehicles}

  @doc "The metric families of a gateway; those of parts that do not run have no samples."
  @spec families(term()) :: [Text.family()]
  def families(gateway) do
    links = MavRouter.Link.list(gateway)
    counters = Store.counters(gateway)

    Links.families(links) ++
      Vehicles.families(Store.vehicles(gateway), links, System.os_time(:microsecond)) ++
      parts(gateway) ++
      Clients.families(MavRouter.Client.list(gateway), MavRouter.Client.endpoints(gateway), counters) ++
      Policy.families(gateway, counters) ++
      [sent(counters), others(counters)] ++ vm()
  end

  defp parts(gateway) do
    for part <- [Aerie.Fleet.Bridge, MavRouter.Recorder, Commands, Shadow],
        %{name: name, type: type, help: help, samples: samples} <- part.metrics(gateway),
        do: {name, type, help, samples}
  end

  defp sent(counters) do
    samples = for {{:sent, id}, n} <- counters, is_integer(id), do: {MavRouter.Link.message_name(id), n}

    {"gateway_mavlink_messages_sent_total", :counter, "Messages that the gateway itself sent.",
     samples |> sum_by_name() |> Enum.map(fn {name, n} -> {[type: name], n} end)}
  end

  defp others(counters) do
    samples =
      for {name, n} <- counters,
          not match?({:sent, _id}, name) and not Clients.own?(name) and not Policy.own?(name) and
            not Commands.counter?(name) and not Shadow.counter?(name),
          do: {[name: counter_name(name)], n}

    {"gateway_occurrences_total", :counter, "Drops, refusals and what else is counted, by name.",
     Enum.sort(samples)}
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
