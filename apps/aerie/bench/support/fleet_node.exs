# A whole gateway with an embedded nats-server, as bench/fleet.exs starts it in an OS process of its own:
#
#     mix run --no-compile bench/support/fleet_node.exs FOLDER PORT LINKS REMOTE
#
# REMOTE is 1 for a hub. Says "ready URL" when it listens; at each line of its standard input what was counted since the last one, as JSON;
# ends with it. Ages are measured by looking, every millisecond, at ten of the vehicles.
Code.require_file("config.ex", __DIR__)

defmodule FleetNode do
  alias Aerie.Base.Store
  alias Aerie.Fleet
  alias Aerie.Fleet.Bridge

  @gateway :bench
  # Vehicles that are looked at.
  @watched 10

  def main(folder, port, links, remote) do
    Logger.configure(level: :error)

    config =
      Aerie.Bench.Config.new(folder, [
        {"limits.max_links", 200},
        {"nats.port", 0},
        {"nats.store_dir", Path.join(folder, "nats")},
        {"remote.enabled", remote == "1"}
      ])

    {:ok, _gateway} = Aerie.Gateway.start_link(name: @gateway, config: config)

    for n <- 0..(links - 1),
        do: {:ok, _} = MavRouter.Link.start(@gateway, "udpin:127.0.0.1:#{port + n}", network: "n#{n}")

    await_nats()
    store = spawn_link(fn -> watch(for(n <- 1..@watched, do: {"n0", n}), &boot/1, &clock/0, %{}, []) end)
    far = for n <- 1..@watched, do: "FAR-#{String.pad_leading("#{n * 90}", 4, "0")}"
    shown = if remote == "1", do: spawn_link(fn -> watch(far, &position/1, &wall/0, %{}, []) end)
    IO.puts("ready #{Bridge.login_url(@gateway)}")
    answer(%{store: store, shown: shown}, counted())
  end

  defp await_nats do
    with %{connected: true, problem: nil} <- Bridge.info(@gateway) do
      :ok
    else
      _not_yet ->
        Process.sleep(50)
        await_nats()
    end
  end

  defp answer(watchers, before) do
    case IO.read(:stdio, :line) do
      line when is_binary(line) ->
        # What was under way arrives.
        Process.sleep(1_500)
        now = counted()
        # Before the memory is tidied up, which takes so long that vehicles become stale.
        heard = Enum.count(Store.vehicles(@gateway), &(&1.status == :online))

        now
        |> Map.new(fn {name, n} -> {name, n - Map.fetch!(before, name)} end)
        |> Map.merge(%{
          store: ages(watchers.store),
          shown: ages(watchers.shown),
          memory: memory(),
          ring: ring(),
          watched: for(n <- 1..@watched, %{id: id} <- [Store.vehicle(@gateway, {"n0", n})], do: id),
          heard: heard
        })
        |> JSON.encode!()
        |> IO.puts()

        answer(watchers, now)

      _closed ->
        Aerie.Gateway.stop(@gateway)
    end
  end

  # Of the VM, without garbage and without code, which is loaded when it is first called.
  defp memory do
    Enum.each(Process.list(), &:erlang.garbage_collect/1)
    :erlang.memory(:total) - :erlang.memory(:code)
  end

  # What the recorder keeps of the last minutes of each vehicle.
  defp ring do
    %{ring: ring} = MavRouter.Recorder.Tables.of(@gateway)
    :ets.info(ring, :memory) * :erlang.system_info(:wordsize)
  end

  defp ages(nil), do: nil

  defp ages(watcher) do
    send(watcher, {:ages, self()})

    receive do
      {:ages, []} -> nil
      {:ages, ages} -> spread(Enum.sort(ages))
    end
  end

  defp spread(ages), do: Enum.map([0.5, 0.99, 1.0], &Enum.at(ages, max(ceil(length(ages) * &1) - 1, 0)))

  defp counted do
    links = Store.links(@gateway)
    sum = fn name -> links |> Enum.map(&Map.fetch!(&1.counters, name)) |> Enum.sum() end
    telemetry = for %{counters: %{messages: messages}} <- links, {id, n} <- messages, id != 0, do: n

    %{
      received: Enum.sum(telemetry),
      dropped: Enum.sum(Enum.map([:kernel_dropped, :shed, :unclaimed, :overload], sum)),
      superseded: metric("gateway_nats_state_superseded_total"),
      published: metric("gateway_nats_messages_published_total"),
      remote: Store.counter(@gateway, {:remote, :taken}),
      remote_dropped: Store.counter(@gateway, {:remote, :dropped})
    }
  end

  defp metric(name) do
    for(%{name: ^name, samples: samples} <- Bridge.metrics(@gateway), {_labels, n} <- samples, do: n)
    |> Enum.sum()
  end

  defp watch(keys, look, clock, seen, ages) do
    receive do
      {:ages, whom} ->
        send(whom, {:ages, ages})
        watch(keys, look, clock, seen, [])
    after
      1 ->
        now = clock.()

        {seen, ages} =
          for key <- keys, at = look.(key), is_integer(at) and at != seen[key], reduce: {seen, ages} do
            {seen, ages} -> {Map.put(seen, key, at), [now - at | ages]}
          end

        watch(keys, look, clock, seen, ages)
    end
  end

  # Not the whole snapshot: looking must not cost more than what is looked at.
  defp boot(key) do
    shown = [{{key, :_, %{time_boot_ms: :"$1"}}, [], [:"$1"]}]
    Store.with_table(@gateway, :vehicles, nil, &List.first(:ets.select(&1, shown)))
  end

  # CLOCK_MONOTONIC, which is what the vehicles' clocks are.
  defp clock, do: div(:os.perf_counter(:microsecond), 1000)

  defp position(id) do
    with %{groups: %{position: %{at: at}}} <-
           Fleet.RemoteTable.vehicle(@gateway, id, System.os_time(:microsecond)),
         do: div(at, 1000)
  end

  defp wall, do: System.os_time(:millisecond)
end

[folder, port, links, remote] = System.argv()
FleetNode.main(folder, String.to_integer(port), String.to_integer(links), remote)
