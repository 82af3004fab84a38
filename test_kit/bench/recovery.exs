# Measures how long the gateway lacks a part that was killed while three simulated vehicles fly: each process of a
# vehicle's and a link's tree, and nats-server. A process is back when it is registered again and has heard its
# vehicle, nats-server when it is connected again. Then the whole gateway is killed in flight and started again by
# `bin/run`, timed from the start.
#
#     bin/bench recovery [--rounds 5]

Code.require_file("harness.exs", __DIR__)

defmodule RecoveryBench do
  import Bench.Sample, only: [until: 2]

  alias Aerie.Base.{Names, Store}
  alias Bench.{BinRun, Gateway, OSProcess, Sample, Table}

  @gateway :recovery
  @key {"main", 1}
  @widths [32, -10, -10]

  def main(folder, rounds) do
    {:ok, supervisor} = Supervisor.start_link([], strategy: :one_for_one)
    start(supervisor, folder)
    until(fn -> Enum.all?(1..3, &flies?/1) end, 1)
    until(fn -> match?(%{connected: true}, Aerie.Fleet.Bridge.info(@gateway)) end, 1)

    parts = [
      {"vehicle: session", process(rounds, :session, @key)},
      {"vehicle: events", process(rounds, :events, @key)},
      {"vehicle: whole tree", process(rounds, :tree, @key)},
      {"link: process", process(rounds, :link, "link-1")},
      {"link: whole tree", process(rounds, :link_tree, "link-1")},
      # Its restarts back off, so it is killed only a few times.
      {"nats-server, connected again", nats(min(rounds, 3), Path.join(folder, "nats/nats-server.pid"))}
    ]

    whole = whole(Path.join(folder, "whole"), rounds)

    names = [
      answers: "gateway: it answers",
      online: "gateway: vehicle in the store",
      state: "gateway: state in NATS",
      position: "gateway: position in NATS"
    ]

    IO.puts(
      "killed #{rounds} times each while three vehicles fly; ms until it is back and has heard its vehicle\n"
    )

    Table.columns(["part", "median", "max"], @widths)

    for {name, times} <- parts ++ for({key, name} <- names, do: {name, Enum.map(whole, & &1[key])}) do
      figures =
        for ms <- [Sample.median(times), Enum.max(times)], do: :erlang.float_to_binary(ms, decimals: 1)

      Table.columns([name | figures], @widths)
    end

    others = for n <- 2..3, do: Store.link(@gateway, "link-#{n}").counters
    [frames, lost] = for name <- [:frames_in, :lost], do: Enum.sum_by(others, &Map.fetch!(&1, name))
    IO.puts("\nframes of the two other vehicles: #{frames}, lost: #{lost}")
    Supervisor.stop(supervisor)
  end

  defp start(supervisor, folder) do
    ports = for n <- 1..3, do: {n, OSProcess.free_port(:gen_udp)}

    overrides = %{
      "links" => for({n, port} <- ports, do: %{"id" => "link-#{n}", "url" => "udpin:127.0.0.1:#{port}"}),
      "mavlink" => %{"local_addr" => "off"},
      "http" => %{"port" => 0},
      "nats" => %{"port" => 0, "store_dir" => Path.join(folder, "nats")},
      "outbox" => %{"dir" => Path.join(folder, "outbox")}
    }

    options = [gateway: @gateway, supervisor: supervisor, status: false]
    {:ok, _run} = Aerie.CLI.Start.Run.start(%{config_file: nil, overrides: overrides, sim: 0}, options)

    for {n, port} <- ports,
        do: Gateway.sim(port, system: n, ready_s: 1.0, script: SimVehicle.Pilot.pattern(n))
  end

  defp flies?(n), do: get_in(Store.vehicle(@gateway, "VID-00#{n}") || %{}, [:groups, :mode, :data, :in_air])
  defp heard, do: Store.vehicle(@gateway, "VID-001").last_heard

  defp process(rounds, role, id) do
    for _round <- 1..rounds do
      pid = until(fn -> Names.whereis(@gateway, role, id) end, 1)
      reference = Process.monitor(pid)
      Process.exit(pid, :kill)
      receive do: ({:DOWN, ^reference, :process, _pid, _reason} -> :ok)
      last = heard()

      Sample.ms(fn ->
        until(fn -> Names.whereis(@gateway, role, id) not in [nil, pid] and heard() > last end, 1)
      end)
    end
  end

  defp nats(rounds, pid_file) do
    back? = fn -> match?(%{connected: true, server: %{status: :up}}, Aerie.Fleet.Bridge.info(@gateway)) end

    for _round <- 1..rounds do
      System.cmd("kill", ["-KILL", String.trim(File.read!(pid_file))])
      until(fn -> match?(%{connected: false}, Aerie.Fleet.Bridge.info(@gateway)) end, 1)
      Sample.ms(fn -> until(back?, 1) end)
    end
  end

  # Uses only public interfaces. The first round is a warm-up.
  defp whole(dir, rounds) do
    port = OSProcess.free_port(:gen_udp)
    Gateway.sim(port, ready_s: 1.0)
    [_warm | rounds] = for _round <- 0..rounds, do: round(dir, "udpin:127.0.0.1:#{port}")
    rounds
  end

  defp round(dir, url) do
    gateway = BinRun.start(dir, url)
    nats = Task.async(fn -> first_states(gateway) end)
    times = for what <- [:answers, :online], into: %{}, do: {what, BinRun.until(gateway, what)}
    times = Map.merge(times, Task.await(nats, :infinity))
    BinRun.kill(gateway)
    times
  end

  defp first_states(gateway) do
    url = Path.join(gateway.dir, "nats/url")

    nats =
      until(
        fn ->
          with {:ok, "nats://" <> _ = text} <- File.read(url),
               %URI{host: host, port: port, userinfo: token} = URI.parse(String.trim(text)),
               {:ok, nats} <- Gnat.start_link(%{host: host, port: port, token: token}),
               do: nats,
               else: (_not_yet -> nil)
        end,
        5
      )

    {:ok, _sid} = Gnat.sub(nats, self(), "fleet.*.*.state.*")
    times = states(gateway, %{})
    Gnat.stop(nats)
    times
  end

  # When the first state of any group came, and the first position.
  defp states(gateway, times) do
    receive do
      {:msg, %{topic: topic}} ->
        times = Map.put_new(times, :state, BinRun.since(gateway))

        if String.ends_with?(topic, ".position"),
          do: Map.put(times, :position, BinRun.since(gateway)),
          else: states(gateway, times)
    end
  end
end

options = Bench.Options.read(__ENV__.file, rounds: 5)
Bench.Gateway.in_folder("recovery", &RecoveryBench.main(&1, options[:rounds]))
