# How much the bridge carries against the real nats-server on this machine, and how long a killed server is missed.
#
#     bin/bench bridge

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
[] = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), [])

alias Aerie.Base.Store
alias Aerie.Config
alias Aerie.Fleet.Bridge
alias Aerie.Vehicle.Journal
alias Aerie.Base.PubSub
alias Aerie.Vehicle.Event

Logger.configure(level: :none)
dir = Path.join(System.tmp_dir!(), "aerie-bench-#{System.pid()}")
gateway = make_ref()

config =
  Config.default([
    {"nats.port", 0},
    {"nats.store_dir", Path.join(dir, "nats")},
    {"outbox.dir", Path.join(dir, "outbox")}
  ])

parts = Aerie.Gateway.parts(gateway, config)
{:ok, _} = Store.start_link([gateway: gateway] ++ parts[Store])
{:ok, _} = PubSub.start_link(gateway: gateway)
PubSub.subscribe(gateway, :bridge)

wait = fn part, fun ->
  loop = fn loop ->
    receive do
      {:fleet, :bridge, {^part, info}} -> if fun.(info), do: info, else: loop.(loop)
    end
  end

  loop.(loop)
end

up? = &(&1[:status] == :up and &1[:streams] == :ok)

ms = fn fun ->
  started = System.monotonic_time(:microsecond)
  fun.()
  (System.monotonic_time(:microsecond) - started) / 1000
end

start =
  ms.(fn ->
    {:ok, _} = Bridge.Supervisor.start_link([gateway: gateway] ++ parts[Bridge.Supervisor])
    wait.(:connection, up?)
  end)

IO.puts("from nothing to connected with streams: #{round(start)} ms")

metric = fn name ->
  for(%{name: ^name, samples: samples} <- Bridge.metrics(gateway), {_, n} <- samples, do: n) |> Enum.sum()
end

data = %{
  data: %{lat: 47.3977419, lon: 8.5455938, alt_msl: 488.1, alt_rel: 10.2, heading: 271.5},
  time_boot_ms: 123_456
}

count = 50_000

time =
  ms.(fn -> for n <- 1..count, do: Bridge.publish_state(gateway, "V#{rem(n, 250)}", :position, data, n) end)

IO.puts("state: #{Float.round(time * 1000 / count, 1)} us in the vehicle's process for each publish_state/5")

settled = fn settled, before ->
  now = metric.("gateway_nats_messages_published_total")

  if now == before,
    do: now,
    else:
      (
        Process.sleep(100)
        settled.(settled, now)
      )
end

published = settled.(settled, -1)
superseded = metric.("gateway_nats_state_superseded_total")

IO.puts(
  "state: of #{count} as fast as one process can, #{published} published, #{superseded} superseded by newer ones"
)

events = fn vehicles, each, offset ->
  for v <- 1..vehicles do
    made =
      for n <- 1..each,
          do: Event.new("V#{v}", "statustext", offset + n, n, n, %{"text" => "PreArm: check #{n}"})

    Journal.commit(gateway, "V#{v}", :state, made)
  end
end

empty = fn empty ->
  if Journal.pending_size(gateway) == 0,
    do: :ok,
    else:
      (
        Process.sleep(1)
        empty.(empty)
      )
end

for {vehicles, each} <- [{1, 3000}, {100, 40}] do
  time =
    ms.(fn ->
      events.(vehicles, each, vehicles * 1_000_000)
      empty.(empty)
    end)

  IO.puts(
    "events: #{vehicles * each} of #{vehicles} vehicles confirmed in #{round(time)} ms, #{round(vehicles * each / time * 1000)}/s"
  )
end

pid = dir |> Path.join("nats/nats-server.pid") |> File.read!() |> String.trim()

back =
  ms.(fn ->
    System.cmd("sh", ["-c", "kill -KILL #{pid}"])
    wait.(:connection, &(&1[:status] == :down))
    wait.(:connection, up?)
  end)

IO.puts("kill -9 of nats-server: connected again with streams after #{round(back)} ms")

{:ok, outbox} =
  Bridge.Outbox.open(Path.join(dir, "outbox-alone"), max_bytes: 67_108_864, segment_bytes: 1_048_576)

record = %Bridge.Outbox.Record{
  id: String.duplicate("a", 32),
  vehicle: "V1",
  subject: "fleet.prod.V1.event.statustext",
  body: String.duplicate("b", 200)
}

time =
  ms.(fn ->
    Enum.reduce(1..20_000, outbox, fn _, outbox ->
      {:ok, outbox} = Bridge.Outbox.append(outbox, [record])
      outbox
    end)
  end)

IO.puts("outbox: #{Float.round(time * 1000 / 20_000, 1)} us for each event written alone (no fsync)")

Supervisor.stop(Aerie.Base.Names.via(gateway, :bridge))
File.rm_rf!(dir)
