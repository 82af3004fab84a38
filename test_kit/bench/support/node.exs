# A gateway in an OS process of its own, for benchmarks:
#
#     mix run --no-compile support/node.exs JSON
#
# JSON says its links ("urls", each with the network n0, n1 … unless "network" names one), "client", "vehicles" (the
# most), "folder" and "remote" for a whole gateway with a nats-server, of a hub or not. Without a folder it has neither
# NATS nor a console. Says "ready", with the address of NATS if there is one, when it listens; at each line of its
# standard input what was counted since the last one, as JSON; ends with it. Ages are measured by looking, every
# millisecond, at ten of the vehicles.
Code.require_file("sample.ex", __DIR__)
Code.require_file("gateway.ex", __DIR__)

defmodule BenchNode do
  alias Aerie.Base.{PubSub, Store}
  alias Aerie.Fleet
  alias Bench.{Gateway, Sample}

  @gateway :bench
  # Vehicles that are looked at.
  @watched 1..10
  @parts [Store, PubSub, MavRouter.Router.Supervisor, Aerie.Vehicle.Supervisor, MavRouter.Link.Supervisor]

  def main(options) do
    Logger.configure(level: :error)
    whole? = is_binary(options["folder"])
    start(options, whole?)

    for {url, n} <- Enum.with_index(options["urls"]),
        do: Gateway.link(@gateway, url, network: options["network"] || "n#{n}")

    if url = options["client"], do: Gateway.client(@gateway, url)
    if whole?, do: Sample.until(&connected?/0, 50)
    # Whoever routes frames to a client is measured at the client.
    store =
      if !options["client"],
        do: spawn_link(fn -> watch(for(n <- @watched, do: {"n0", n}), &boot/1, &clock/0, %{}, []) end)

    far = for n <- @watched, do: "FAR-#{String.pad_leading("#{n * 90}", 4, "0")}"
    shown = if options["remote"], do: spawn_link(fn -> watch(far, &position/1, &wall/0, %{}, []) end)
    IO.puts("ready " <> if(whole?, do: Fleet.Bridge.login_url(@gateway), else: ""))
    answer(%{store: store, shown: shown}, whole?, counted(whole?))
    if whole?, do: Aerie.Gateway.stop(@gateway)
  end

  defp start(%{"folder" => folder} = options, true) do
    Gateway.whole(@gateway, Gateway.config(folder, [{"nats.port", 0}, {"remote.enabled", options["remote"]}]))
  end

  defp start(options, false) do
    # What vehicles hear of each other is not what is measured.
    more =
      if options["client"], do: [{"router.between_vehicles", "none"}, {"limits.max_peers", 256}], else: []

    most = if most = options["vehicles"], do: [{"limits.max_vehicles", most}], else: []
    Gateway.parts(@gateway, Gateway.config(System.tmp_dir!(), most ++ more), @parts)
  end

  defp connected?, do: match?(%{connected: true, problem: nil}, Fleet.Bridge.info(@gateway))

  defp answer(watchers, whole?, before) do
    if is_binary(IO.read(:stdio, :line)) do
      # What was under way arrives.
      Process.sleep(1_500)
      now = counted(whole?)
      # Before the memory is tidied up, which takes so long that vehicles become stale.
      heard = Enum.count(Store.vehicles(@gateway), &(&1.status == :online))
      ages = Map.new(watchers, fn {name, watcher} -> {name, ages(watcher)} end)
      watched = for n <- @watched, %{id: id} <- [Store.vehicle(@gateway, {"n0", n})], do: id
      since = Map.new(now, fn {name, n} -> {name, n - Map.fetch!(before, name)} end)
      kept = if whole?, do: %{memory: memory(), ring: ring()}, else: %{}
      report = since |> Map.merge(ages) |> Map.merge(kept) |> Map.merge(%{watched: watched, heard: heard})
      report |> JSON.encode!() |> IO.puts()
      answer(watchers, whole?, now)
    end
  end

  # Of the VM, without garbage and without code, which is loaded when it is first called.
  defp memory do
    Enum.each(Process.list(), &:erlang.garbage_collect/1)
    :erlang.memory(:total) - :erlang.memory(:code)
  end

  # What the recorder keeps of the last minutes of each vehicle.
  defp ring,
    do: :ets.info(MavRouter.Recorder.Tables.of(@gateway).ring, :memory) * :erlang.system_info(:wordsize)

  defp ages(nil), do: nil

  defp ages(watcher) do
    send(watcher, {:ages, self()})
    receive do: ({:ages, ages} -> Sample.spread(ages))
  end

  defp counted(whole?) do
    links = Store.links(@gateway)
    telemetry = for %{counters: %{messages: messages}} <- links, {id, n} <- messages, id != 0, do: n

    dropped =
      for %{counters: counters} <- links,
          name <- ~w(kernel_dropped shed shed_new unclaimed overload)a,
          do: Map.fetch!(counters, name)

    counted = %{received: Enum.sum(telemetry), dropped: Enum.sum(dropped)}

    if whole? do
      Map.merge(counted, %{
        superseded: Gateway.metric(@gateway, "gateway_nats_state_superseded_total"),
        remote: Store.counter(@gateway, {:remote, :taken}),
        remote_dropped: Store.counter(@gateway, {:remote, :dropped})
      })
    else
      counted
    end
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
           Fleet.Remote.Table.vehicle(@gateway, id, System.os_time(:microsecond)),
         do: div(at, 1000)
  end

  defp wall, do: System.os_time(:millisecond)
end

[options] = System.argv()
BenchNode.main(JSON.decode!(options))
