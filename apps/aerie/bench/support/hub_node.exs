# A gateway without NATS and console, as bench/hub.exs starts it in an OS process of its own:
#
#     mix run --no-compile bench/support/hub_node.exs PORT LINKS
#
# Says "ready" when it listens; at each line of its standard input what was counted since the last one, as JSON; ends with
# it. The age of a frame when its state is shown is measured by looking, every millisecond, at a few of the vehicles.
defmodule HubNode do
  alias Aerie.Base.Store

  @gateway :bench
  # Vehicles that are looked at.
  @watched 10

  def main(port, links) do
    config =
      Aerie.Config.default([
        {"mavlink.local_addr", "off"},
        {"mavlink.system_id", 245},
        {"clients", []},
        {"limits.max_links", 200}
      ])

    measured = [
      Store,
      Aerie.Base.PubSub,
      MavRouter.Router.Supervisor,
      Aerie.Vehicle.Supervisor,
      MavRouter.Link.Supervisor
    ]

    for {module, options} <- Aerie.Gateway.parts(@gateway, config),
        module in measured,
        do: {:ok, _pid} = module.start_link([gateway: @gateway] ++ options)

    for n <- 0..(links - 1),
        do: {:ok, _} = MavRouter.Link.start(@gateway, "udpin:127.0.0.1:#{port + n}", network: "n#{n}")

    watch = spawn_link(fn -> watch(for(n <- 1..@watched, do: {"n0", n}), %{}, []) end)
    IO.puts("ready")
    answer(watch, counted())
  end

  defp answer(watch, before) do
    case IO.read(:stdio, :line) do
      line when is_binary(line) ->
        # What was under way arrives.
        Process.sleep(1_500)
        now = counted()
        send(watch, {:ages, self()})

        ages =
          receive do
            {:ages, ages} -> Enum.sort(ages)
          end

        report = Map.new(now, fn {name, n} -> {name, n - Map.fetch!(before, name)} end)

        shown = %{
          p50: at(ages, 0.5),
          p99: at(ages, 0.99),
          max: at(ages, 1.0),
          vehicles: vehicles()
        }

        report |> Map.merge(shown) |> JSON.encode!() |> IO.puts()
        answer(watch, now)

      _closed ->
        :ok
    end
  end

  defp at([], _part), do: nil
  defp at(ages, part), do: Enum.at(ages, max(ceil(length(ages) * part) - 1, 0))

  defp vehicles, do: Enum.count(Store.vehicles(@gateway), &(&1.status == :online))

  defp counted do
    links = Store.links(@gateway)
    sum = fn name -> links |> Enum.map(&Map.fetch!(&1.counters, name)) |> Enum.sum() end

    telemetry =
      for %{counters: %{messages: messages}} <- links, {id, n} <- messages, id != 0, do: n

    names = [:kernel_dropped, :shed, :unclaimed, :overload, :peers_refused]
    Map.merge(Map.new(names, &{&1, sum.(&1)}), %{received: Enum.sum(telemetry)})
  end

  defp watch(keys, seen, ages) do
    receive do
      {:ages, whom} ->
        send(whom, {:ages, ages})
        watch(keys, seen, [])
    after
      1 ->
        now = now()

        {seen, ages} =
          for key <- keys, boot = boot(key), boot != seen[key], reduce: {seen, ages} do
            {seen, ages} -> {Map.put(seen, key, boot), [now - boot | ages]}
          end

        watch(keys, seen, ages)
    end
  end

  defp boot(key) do
    with %{time_boot_ms: boot} <- Store.vehicle(@gateway, key), do: boot
  end

  # CLOCK_MONOTONIC, which is what the vehicles' clocks are.
  defp now, do: div(:os.perf_counter(:microsecond), 1000)
end

[port, links] = System.argv()
HubNode.main(String.to_integer(port), String.to_integer(links))
