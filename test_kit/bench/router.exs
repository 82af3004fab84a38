# The router beside others on the same machine in the same run: one source of frames and 1, 5 and 20 clients over UDP,
# one frame a datagram; then 100 links of 100 frames/s. Each router is one OS process on one core (two for the 100
# links), the load another one on the other core, a small C program in support/; as root the router with nice -20 and
# the load with real-time priority, so that other work on the machine counts less. "Aerie" is what bin/run starts, with
# NATS and HTTP, and the source is a vehicle, which the gateway keeps the state of. "without NATS, HTTP" leaves these
# out. In the row "no vehicle" the source is none either, and routing is all there is to do.
#
#     bin/bench router [--seconds N] [--clients 1,5,20] [--quick]
#
# Prints a table in Markdown, as the README of the router has one. Columns: frames/s that were sent for three seconds
# (in bursts, every 200 us) and arrived at every client without loss and within 50 ms; p50 and p99 of the added latency
# at 1,000 and 10,000 frames/s, in microseconds; CPU seconds per 100,000 frames that came in, at 10,000 frames/s;
# memory for each further client. Before it a small table: what it costs to decide whether a frame may reach vehicles.
#
# Beside it run, where they are there: mavp2p (on the path, or built with go into a folder that goes with this run),
# mavlink-router (mavlink-routerd on the path) and MAVProxy (mavproxy.py in the Python environment or on the path).
# What is not there is said and left out.

Code.require_file("harness.exs", __DIR__)

defmodule RouterBench.Peers do
  @moduledoc """
  Routers: how each is started on the ports of its source and its clients, how far apart the clients' ports are, and
  what it says when it is ready. One that says nothing gets three seconds.
  """
  alias Bench.{BinRun, OSProcess}

  @mavp2p "v1.3.3"

  # As bin/run starts it; a start has a folder of its own.
  def aerie(dir) do
    command = fn source, client, _n ->
      folder = Path.join(dir, "gateway-#{source}")
      config = Path.join(folder, "gateway.yaml")
      File.mkdir_p!(folder)

      File.write!(config, """
      links: [{id: in, url: "udpin:127.0.0.1:#{source}"}]
      clients: [{id: out, url: "udpin:127.0.0.1:#{client}"}]
      #{BinRun.files(folder)}
      """)

      start = ["--no-halt", "-e", "Aerie.CLI.Start.main(System.argv())", "--", "--quiet"]
      OSProcess.mix(start ++ ["--config", config, "--http", "0", "--nats", "embedded"])
    end

    %{name: "Aerie", vehicle?: true, step: 0, ready: "connected to NATS at", command: command}
  end

  @doc "A gateway of so many links and at most so many vehicles, without NATS and HTTP."
  def router_only(name, vehicle?, links \\ 1, vehicles \\ 250) do
    command = fn source, client, _n ->
      urls = for n <- 0..(links - 1), do: "udpin:127.0.0.1:#{source + n}"

      OSProcess.node_command(%{
        urls: urls,
        client: "udpin:127.0.0.1:#{client}",
        network: "main",
        vehicles: vehicles
      })
    end

    %{name: name, vehicle?: vehicle?, step: 0, ready: "ready", command: command}
  end

  @doc "Those of others that are here; says what is not."
  def others(dir), do: Enum.flat_map([mavp2p(dir), mavlink_router(dir), mavproxy()], &found/1)

  defp found({_name, nil, why, _step, _words}), do: List.wrap(IO.puts(why) && nil)

  defp found({name, path, _why, step, words}) do
    command = fn source, client, n -> {path, words.(source, for(i <- 0..(n - 1), do: client + i))} end
    [%{name: name, vehicle?: true, step: step, ready: nil, command: command}]
  end

  defp mavp2p(dir) do
    {path, why} =
      case {System.find_executable("mavp2p"), System.find_executable("go")} do
        {nil, nil} -> {nil, "mavp2p: neither it nor go is here: left out"}
        {nil, go} -> build_mavp2p(go, dir)
        {path, _go} -> {path, nil}
      end

    words = fn source, [client | _] ->
      ["udps:127.0.0.1:#{source}", "udps:127.0.0.1:#{client}", "--hb-disable", "--streamreq-disable"]
    end

    {"mavp2p", path, why, 0, words}
  end

  # In a module of its own: `go install` asks for a list of versions, which not every module proxy has.
  defp build_mavp2p(go, dir) do
    module = Path.join(dir, "go")
    File.mkdir_p!(module)
    package = "github.com/bluenviron/mavp2p"
    text = "module bench\n\ngo 1.24\n\ntool #{package}\n\nrequire #{package} #{@mavp2p}\n"
    File.write!(Path.join(module, "go.mod"), text)
    args = ["build", "-mod=mod", "-o", Path.join(dir, "mavp2p"), package]

    case System.cmd(go, args, cd: module, stderr_to_stdout: true) do
      {_text, 0} -> {Path.join(dir, "mavp2p"), nil}
      {text, _status} -> {nil, "mavp2p: left out, go build says: #{text |> String.split("\n") |> hd()}"}
    end
  end

  # A server endpoint of its answers the peer it heard last, so that each client has a port of its own.
  defp mavlink_router(dir) do
    words = fn source, clients ->
      file = Path.join(dir, "mavlink-router.conf")
      ports = [{"source", source} | for({client, i} <- Enum.with_index(clients), do: {"client#{i}", client})]

      servers =
        for {name, port} <- ports, do: "[UdpEndpoint #{name}]\nMode=Server\nAddress=127.0.0.1\nPort=#{port}\n"

      File.write!(file, ["[General]\nTcpServerPort=0\n" | servers])
      ["--conf-file", file]
    end

    why = "mavlink-router: mavlink-routerd is not on the path: left out"
    {"mavlink-router", System.find_executable("mavlink-routerd"), why, 1, words}
  end

  # Each of its outputs talks to one peer, so that each client has a port of its own.
  defp mavproxy do
    own = Path.join(System.get_env("AERIE_VENV", ""), "bin/mavproxy.py")
    path = if File.exists?(own), do: own, else: System.find_executable("mavproxy.py")
    alone = ["--daemon", "--non-interactive", "--state-basedir=#{System.tmp_dir!()}"]

    words = fn source, clients ->
      ["--master=udpin:127.0.0.1:#{source}"] ++
        alone ++ for(client <- clients, do: "--out=udpin:127.0.0.1:#{client}")
    end

    {"MAVProxy", path, "MAVProxy: mavproxy.py is not here: left out (pip install MAVProxy brings it)", 1,
     words}
  end
end

defmodule RouterBench do
  alias Bench.{OSProcess, Table}
  alias RouterBench.Peers

  @rates [20_000, 40_000, 60_000, 80_000, 100_000, 125_000, 150_000, 200_000]
  # As the README of the router has it.
  @widths [18, 7, 17, 19, 24, 13, 10]
  # From the port of the source to that of the first client.
  @client 200

  def main(dir, options) do
    quick? = options[:quick]

    context = %{
      load: OSProcess.compile("router_load", dir),
      seconds: options[:seconds] || if(quick?, do: 1, else: 4),
      clients: Bench.Options.numbers(options[:clients]),
      rates: if(quick?, do: [20_000, 80_000], else: @rates)
    }

    own = [
      Peers.aerie(dir),
      Peers.router_only("without NATS, HTTP", true),
      Peers.router_only("no vehicle", false)
    ]

    routers = own ++ Peers.others(dir)
    IO.puts("")
    latencies = ["p50 / p99 at 1,000", "p50 / p99 at 10,000"]
    Table.head(["", "clients", "frames/s, no loss"] ++ latencies ++ ["CPU s/100,000", "KiB/client"], @widths)
    for router <- routers, do: table(router, context)

    for {name, vehicles} <- [{"routing alone", 1}, {"with the vehicles' sessions", 250}],
        do: hundred(name, Peers.router_only(name, true, 100, vehicles), context)
  end

  defp table(router, %{clients: [first | _]} = context) do
    Enum.reduce(context.clients, nil, fn n, alone ->
      {cells, rss} = measure(router, n, context)
      each = if alone && n > first, do: max(round((rss - alone) / (n - first)), 0), else: ""
      Table.row([router.name, n] ++ cells ++ [each], @widths)
      alone || rss
    end)
  end

  defp measure(router, n, context) do
    with_router(router, n, "0", fn running ->
      run = &load(context, router, running, [n, &1, &2, 1, 0])
      [slow, fast] = for rate <- [1_000, 10_000], do: run.(rate, context.seconds)
      rss = OSProcess.number(running.pid, "status", "VmRSS")
      best = context.rates |> Enum.take_while(&lossless?(run, &1)) |> List.last("< #{hd(context.rates)}")
      loses = if fast["lost"] > 0, do: " (loses)", else: ""
      {[best, latency(slow), latency(fast), "#{cost(fast)}#{loses}"], rss}
    end)
  end

  # A machine that does something else for a moment is not a router's fault: three tries.
  defp lossless?(run, rate) do
    Enum.any?(1..3, fn _ ->
      result = run.(rate, 3)
      result["lost"] == 0 and result["p99"] < 50_000
    end)
  end

  defp latency(%{"lost" => 0} = r), do: [r["p50"], r["p99"]]
  defp latency(r), do: "#{r["p50"]} / #{r["p99"]}, loses #{Float.round(100 * r["lost"] / r["sent"], 1)} %"

  # CPU seconds per 100,000 frames.
  defp cost(r), do: Float.round(r["cpu"] * 100_000 / r["sent"], 2)

  defp hundred(name, router, context) do
    r = with_router(router, 1, "0,1", &load(context, router, &1, [1, 10_000, 2 * context.seconds, 100, 1]))

    IO.puts(
      "100 links of 100 frames/s on two cores, #{name}: sent #{r["sent"]}, lost #{r["lost"]}, p50 #{r["p50"]} us, " <>
        "p99 #{r["p99"]} us, CPU #{cost(r)} s per 100,000 frames"
    )
  end

  # A hundred ports are for links, then come those of the clients, then those that the load sends from.
  defp with_router(router, n, cores, fun) do
    base = OSProcess.base_port(0..700)

    {command, args} =
      router.command.(base, base + @client, n) |> pinned(cores) |> preferred("nice", ["-n", "-20"])

    env = [{~c"MIX_ENV", ~c"prod"}]

    port =
      Port.open({:spawn_executable, command}, [:binary, :exit_status, :stderr_to_stdout, args: args, env: env])

    {:os_pid, pid} = Port.info(port, :os_pid)

    try do
      if router.ready, do: await(port, router.ready), else: Process.sleep(3_000)
      # A wrapper's child does the work.
      busiest = pid |> OSProcess.tree() |> Enum.max_by(&OSProcess.number(&1, "status", "VmRSS"))
      fun.(%{base: base, pid: busiest, cores: cores})
    after
      System.cmd("kill", ["#{pid}"], stderr_to_stdout: true)
      if Port.info(port), do: Port.close(port)
      Process.sleep(300)
    end
  end

  defp await(port, word) do
    receive do
      {^port, {:data, text}} -> text =~ word || await(port, word)
      {^port, {:exit_status, status}} -> raise "it ended with #{status}"
    after
      60_000 -> raise "it does not start"
    end
  end

  defp load(context, router, %{base: base, pid: pid, cores: cores}, [clients, rate, seconds, sources, step]) do
    before = OSProcess.cpu(pid)
    vehicle = if router.vehicle?, do: 3, else: 8
    args = [base, base + @client, router.step, clients, rate, seconds, sources, step, vehicle]
    alone? = cores == "0"
    command = pinned({context.load, Enum.map(args, &to_string/1)}, if(alone?, do: "1", else: cores))
    # Not where router and load share the cores.
    {command, args} = if alone?, do: preferred(command, "chrt", ["-f", "1"]), else: command
    result = OSProcess.load(command, args)

    Map.merge(result, %{
      "lost" => max(result["sent"] - result["worst"], 0),
      "cpu" => OSProcess.cpu(pid) - before
    })
  end

  defp pinned({command, args}, cores) do
    taskset = System.find_executable("taskset")
    if taskset && System.schedulers() > 1, do: {taskset, ["-c", cores, command | args]}, else: {command, args}
  end

  defp preferred({command, args}, program, options) do
    root? = match?({"0\n", 0}, System.cmd("id", ["-u"]))
    path = System.find_executable(program)
    if root? && path, do: {path, options ++ [command | args]}, else: {command, args}
  end
end

defmodule RouterBench.Decision do
  @moduledoc """
  What it costs to decide whether a frame may reach vehicles (`MavRouter.Forward.Gate`), in nanoseconds a frame: reads
  of 16 frames, the median of 15 rounds, in this process alone.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Clients.MavlinkPolicy
  alias Bench.{Sample, Table}
  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages, as: M
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Forward.{Delivery, Gate, Source}

  @gateway :decision_bench
  @reads 2_000
  @frames 16

  def main do
    clients = for role <- [:operator, :viewer], do: %{id: "#{role}", role: role}
    {:ok, policy} = Policy.compile(%{clients: clients})
    {:ok, store} = Policy.Store.start_link(gateway: @gateway, policy: policy)

    telemetry = [
      %M.Attitude{roll: 0.5},
      %M.GlobalPositionInt{lat: 1},
      %M.SysStatus{load: 3},
      %M.VfrHud{alt: 2.0}
    ]

    heartbeat = [%M.Heartbeat{type: 6, autopilot: 8}]
    vehicle = [side: :vehicle, owner: "link", heard_vehicle: true]
    client = &[side: :client, owner: &1, commands: true]
    IO.puts("")
    Table.head(["what a decision costs", "ns a frame"])
    row("telemetry of a vehicle", telemetry, vehicle, true)

    row(
      "telemetry of a vehicle, from this machine",
      telemetry,
      [commands: true, local: true] ++ vehicle,
      true
    )

    row("an operator's heartbeat", heartbeat, client.("operator"), false)
    row("a viewer's heartbeat", heartbeat, client.("viewer"), false)
    GenServer.stop(store)
  end

  defp row(name, messages, fields, vehicle?) do
    frames = messages |> Stream.cycle() |> Enum.take(@frames) |> Enum.map(&frame/1)
    own = [key: {fields[:owner], 1}, networks: ["main"], counters: Counters.new(), gateway: @gateway]
    path = struct!(MavRouter.Forward.Table.Path, own ++ [text: "10.0.0.9:14550"] ++ fields)
    source = %{Source.new(1, 1) | vehicle: vehicle?}

    delivery = %Delivery{
      frames: frames,
      gateway: @gateway,
      tables: %{policy: MavlinkPolicy, readings: nil},
      forwarding: %{paths: %{path.key => path}, listeners: %{}},
      path: path,
      source: source,
      now: 0
    }

    times =
      for _round <- 1..15, do: Sample.ms(fn -> for _read <- 1..@reads, do: Gate.sort(delivery) end)

    Table.row([name, round(Sample.median(times) * 1.0e6 / (@reads * @frames))])
  end

  defp frame(message) do
    bytes = MavCodec.encode(message, system: 1, component: 1)
    {[%Frame{} = frame], _parser} = Parser.push_datagram(Parser.new(), bytes, 5)
    frame
  end
end

options = Bench.Options.read(__ENV__.file, seconds: :integer, clients: "1,5,20", quick: false)
RouterBench.Decision.main()
Bench.Gateway.in_folder("router", &RouterBench.main(&1, options))
