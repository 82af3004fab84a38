# Measures how long the gateway lacks a part that was killed while three simulated vehicles fly: each process of a
# vehicle's and a link's tree, and nats-server. A process is back when it is registered again and has heard its vehicle,
# nats-server when it is connected again. Then the whole gateway is killed in flight and started again by `bin/run`, timed
# from the start.
#
#     bin/bench recovery [--rounds 5]

Code.require_file("support/restart.ex", __DIR__)
Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

alias Aerie.Base.Store
alias Aerie.Base.Names
alias Aerie.CLI.Run

rounds = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), rounds: 5)[:rounds]
Logger.configure(level: :none)

folder = Path.join(System.tmp_dir!(), "aerie-recovery-#{System.os_time()}")
File.mkdir_p!(folder)
{:ok, supervisor} = Supervisor.start_link([], strategy: :one_for_one)
gateway = :recovery

free_port = fn ->
  {:ok, socket} = :gen_udp.open(0, ip: {127, 0, 0, 1})
  {:ok, port} = :inet.port(socket)
  :gen_udp.close(socket)
  port
end

ports = for _n <- 1..3, do: free_port.()

overrides = %{
  "links" =>
    for(
      {port, n} <- Enum.with_index(ports, 1),
      do: %{"id" => "link-#{n}", "url" => "udpin:127.0.0.1:#{port}"}
    ),
  "mavlink" => %{"local_addr" => "off"},
  "http" => %{"port" => 0},
  "nats" => %{"port" => 0, "store_dir" => Path.join(folder, "nats")},
  "outbox" => %{"dir" => Path.join(folder, "outbox")}
}

{:ok, _run} =
  Run.start(%{config_file: nil, overrides: overrides, sim: 0},
    gateway: gateway,
    supervisor: supervisor,
    status: false
  )

for {port, n} <- Enum.with_index(ports, 1) do
  {:ok, _sim} =
    SimVehicle.start_link(
      firmware: :ardupilot,
      system: n,
      link: "udpout:127.0.0.1:#{port}",
      ready_s: 1.0,
      script: SimVehicle.Pilot.pattern(n)
    )
end

defmodule Await do
  def until(fun) do
    case fun.() do
      value when value in [nil, false] ->
        receive do
        after
          1 -> until(fun)
        end

      value ->
        value
    end
  end
end

in_air = fn n ->
  get_in(Store.vehicle(gateway, "VID-00#{n}") || %{}, [:groups, :mode, :data, :in_air]) == true
end

Await.until(fn -> Enum.all?(1..3, in_air) end)
Await.until(fn -> match?(%{connected: true}, Aerie.Fleet.Bridge.info(gateway)) end)

heard = fn -> Store.vehicle(gateway, "VID-001").last_heard end

measure = fn rounds, kill, back ->
  for _round <- 1..rounds do
    kill.()
    start = System.monotonic_time(:microsecond)
    Await.until(back)
    (System.monotonic_time(:microsecond) - start) / 1000
  end
end

key = {"main", 1}

process = fn role, id ->
  {:ok, box} = Agent.start_link(fn -> nil end)

  measure.(
    rounds,
    fn ->
      pid = Await.until(fn -> Names.whereis(gateway, role, id) end)
      reference = Process.monitor(pid)
      Process.exit(pid, :kill)

      receive do
        {:DOWN, ^reference, :process, _pid, _reason} -> :ok
      end

      Agent.update(box, fn _old -> {pid, heard.()} end)
    end,
    fn ->
      {pid, last} = Agent.get(box, & &1)
      now = Names.whereis(gateway, role, id)
      now not in [nil, pid] and heard.() > last
    end
  )
end

# Restarts of nats-server back off, so it is killed only a few times.
nats =
  measure.(
    min(rounds, 3),
    fn ->
      pid_file = Path.join(folder, "nats/nats-server.pid")
      System.cmd("kill", ["-KILL", String.trim(File.read!(pid_file))])
      Await.until(fn -> match?(%{connected: false}, Aerie.Fleet.Bridge.info(gateway)) end)
    end,
    fn -> match?(%{connected: true, server: %{status: :up}}, Aerie.Fleet.Bridge.info(gateway)) end
  )

rows = [
  {"vehicle: session", process.(:session, key)},
  {"vehicle: events", process.(:events, key)},
  {"vehicle: whole tree", process.(:tree, key)},
  {"link: process", process.(:link, "link-1")},
  {"link: whole tree", process.(:link_tree, "link-1")},
  {"nats-server, connected again", nats}
]

whole = Aerie.CLI.Bench.Restart.run(Path.join(folder, "whole"), rounds)

rows =
  rows ++
    for {key, name} <- [
          http: "gateway: it answers",
          store: "gateway: vehicle in the store",
          nats: "gateway: state in NATS",
          position: "gateway: position in NATS"
        ],
        do: {name, Enum.map(whole, & &1[key])}

IO.puts(
  "killed #{rounds} times each while three vehicles fly; ms until it is back and has heard its vehicle\n"
)

IO.puts(String.pad_trailing("part", 32) <> "    median       max")

for {name, times} <- rows do
  times = Enum.sort(times)
  median = Enum.at(times, div(length(times), 2))

  cells =
    for ms <- [median, List.last(times)], do: String.pad_leading(:erlang.float_to_binary(ms, decimals: 1), 10)

  IO.puts(String.pad_trailing(name, 32) <> Enum.join(cells))
end

others = for n <- 2..3, do: Store.link(gateway, "link-#{n}").counters

IO.puts(
  "\nframes of the two other vehicles: #{Enum.sum_by(others, & &1.frames_in)}, lost: #{Enum.sum_by(others, & &1.lost)}"
)

Supervisor.stop(supervisor)
File.rm_rf!(folder)
