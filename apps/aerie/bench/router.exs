# The router beside others on the same machine in the same run: one source of frames and 1, 5 and 20 clients over UDP, one
# frame a datagram; then 100 links of 100 frames/s. Each router is one OS process on one core (two for the 100 links), the
# load another one on the other core, a small C program in bench/support; as root the router with nice -20 and the load with
# real-time priority, so that other work on the machine counts less. "Aerie" is what bin/run starts, with NATS and HTTP, and
# the source is a vehicle, which the gateway keeps the state of. "without NATS, HTTP" leaves these out. In the row "no
# vehicle" the source is none either, and routing is all there is to do.
#
#     mix run bench/router.exs [--seconds N] [--clients 1,5,20] [--quick]          or  bin/bench router
#
# Prints a table in Markdown, as the README of the router has one. Columns: frames/s that were sent for three seconds (in
# bursts, every 200 us) and arrived at every client without loss and within 50 ms; p50 and p99 of the added latency at 1,000 and 10,000 frames/s, in microseconds; CPU
# seconds per 100,000 frames that came in, at 10,000 frames/s; memory for each further client. Before it a small table: what it
# costs to decide whether a frame may reach vehicles.
#
# Beside it run, where they are there: mavp2p (on the path, or built with go into a folder that goes with this run), mavlink-router (mavlink-routerd on the path) and MAVProxy (mavproxy.py in the Python environment or on the path).
# What is not there is said and left out.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/os_process.ex", __DIR__)
Code.require_file("support/decision.exs", __DIR__)

defmodule RouterBench do
  alias Aerie.Bench.OSProcess

  @clients "1,5,20"
  @rates [20_000, 40_000, 60_000, 80_000, 100_000, 125_000, 150_000, 200_000]
  @mavp2p "v1.3.3"

  def main(argv) do
    options =
      MavCodec.Bench.Options.read(__ENV__.file, argv, seconds: :integer, clients: @clients, quick: false)

    seconds = options[:seconds] || if(options[:quick], do: 1, else: 4)
    DecisionBench.main()
    dir = Path.join(System.tmp_dir!(), "router-bench-#{System.pid()}")
    File.mkdir_p!(dir)

    try do
      load = compile(dir)
      bare = %{router_only() | name: "no vehicle", vehicle: false}

      routers = [
        aerie(dir),
        router_only(),
        bare | Enum.flat_map([mavp2p(dir), mavlink_router(dir), mavproxy()], &found/1)
      ]

      context = %{
        load: load,
        seconds: seconds,
        clients: numbers(options[:clients]),
        rates: if(options[:quick], do: [20_000, 80_000], else: @rates)
      }

      IO.puts(
        "\n" <>
          row(
            ["", "clients", "frames/s, no loss", "p50 / p99 at 1,000"] ++
              ["p50 / p99 at 10,000", "CPU s/100,000", "KiB/client"]
          ) <>
          "\n|" <> String.duplicate("---|", 7)
      )

      for router <- routers, do: table(router, context)
      hundred(context)
    after
      File.rm_rf!(dir)
    end
  end

  defp numbers(text), do: for(n <- String.split(text, ","), do: String.to_integer(n))

  defp found({:ok, router}), do: [router]

  defp found({:missing, text}) do
    IO.puts(text)
    []
  end

  defp compile(dir) do
    out = Path.join(dir, "router_load")
    source = Path.join(__DIR__, "support/router_load.c")

    cc =
      System.find_executable("cc") || System.find_executable("gcc") ||
        raise "the load generator needs a C compiler (cc)"

    {_, 0} = System.cmd(cc, ["-O2", "-pthread", "-o", out, source], into: IO.stream())
    out
  end

  ## Routers: how each is started, and on which ports its clients come in

  # As bin/run starts it; a start has a folder of its own.
  defp aerie(dir) do
    %{
      name: "Aerie",
      vehicle: true,
      step: 0,
      ready: "connected to NATS at",
      command: fn source, client, _n ->
        folder = Path.join(dir, "gateway-#{source}")
        config = Path.join(folder, "gateway.yaml")
        File.mkdir_p!(folder)
        File.write!(config, config(folder, source, client))
        start = ["run", "--no-compile", "--no-halt", "-e", "Aerie.CLI.Start.main(System.argv())", "--"]
        words = ["--quiet", "--config", config, "--http", "0", "--nats", "embedded"]
        OSProcess.command(start ++ words)
      end
    }
  end

  defp config(folder, source, client) do
    """
    links: [{id: in, url: "udpin:127.0.0.1:#{source}"}]
    clients: [{id: out, url: "udpin:127.0.0.1:#{client}"}]
    nats: {port: 0, store_dir: "#{folder}/nats"}
    outbox: {dir: "#{folder}/outbox"}
    signing: {dir: "#{folder}/signing"}
    recorder: {dir: "#{folder}/recordings"}
    websocket: {port: 0}
    sockets: {dir: "#{folder}/run"}
    """
  end

  defp router_only do
    %{
      name: "without NATS, HTTP",
      vehicle: true,
      step: 0,
      ready: "ready",
      command: fn source, client, _n ->
        router_node(["udpin:127.0.0.1:#{client}", "udpin:127.0.0.1:#{source}"])
      end
    }
  end

  defp router_node(urls),
    do: OSProcess.command(["run", "--no-compile", Path.join(__DIR__, "support/router_node.exs") | urls])

  defp mavp2p(dir) do
    with nil <- System.find_executable("mavp2p"),
         go when is_binary(go) <-
           System.find_executable("go") ||
             {:missing, "mavp2p: neither it nor go is here: left out"},
         {text, status} = build_mavp2p(go, dir) do
      if status == 0,
        do: {:ok, mavp2p_at(Path.join(dir, "mavp2p"))},
        else: {:missing, "mavp2p: left out, go build says: #{text |> String.split("\n") |> hd()}"}
    else
      path when is_binary(path) -> {:ok, mavp2p_at(path)}
      missing -> missing
    end
  end

  # In a module of its own: `go install` asks for a list of versions, which not every module proxy has.
  defp build_mavp2p(go, dir) do
    module = Path.join(dir, "go")
    File.mkdir_p!(module)
    package = "github.com/bluenviron/mavp2p"

    File.write!(
      Path.join(module, "go.mod"),
      "module bench\n\ngo 1.24\n\ntool #{package}\n\nrequire #{package} #{@mavp2p}\n"
    )

    System.cmd(go, ["build", "-mod=mod", "-o", Path.join(dir, "mavp2p"), package],
      cd: module,
      stderr_to_stdout: true
    )
  end

  defp mavp2p_at(path) do
    %{
      name: "mavp2p",
      step: 0,
      ready: nil,
      command: fn source, client, _n ->
        {path,
         [
           "udps:127.0.0.1:#{source}",
           "udps:127.0.0.1:#{client}",
           "--hb-disable",
           "--streamreq-disable"
         ]}
      end
    }
  end

  # A server endpoint of its answers the peer it heard last, so that each client has a port of its own.
  defp mavlink_router(dir) do
    case System.find_executable("mavlink-routerd") do
      nil ->
        {:missing, "mavlink-router: mavlink-routerd is not on the path: left out"}

      path ->
        {:ok,
         %{
           name: "mavlink-router",
           step: 1,
           ready: nil,
           command: fn source, client, n ->
             file = Path.join(dir, "mavlink-router.conf")
             ports = [{"source", source} | for(i <- 0..(n - 1), do: {"client#{i}", client + i})]
             File.write!(file, ["[General]\nTcpServerPort=0\n" | Enum.map(ports, &udp_server/1)])
             {path, ["--conf-file", file]}
           end
         }}
    end
  end

  defp udp_server({name, port}),
    do: "[UdpEndpoint #{name}]\nMode=Server\nAddress=127.0.0.1\nPort=#{port}\n"

  # Each of its outputs talks to one peer, so that each client has a port of its own.
  defp mavproxy do
    case Enum.find(
           [
             Path.join(System.get_env("AERIE_VENV", ""), "bin/mavproxy.py"),
             System.find_executable("mavproxy.py")
           ],
           &(&1 && File.exists?(&1))
         ) do
      nil ->
        {:missing, "MAVProxy: mavproxy.py is not here: left out (pip install MAVProxy brings it)"}

      path ->
        {:ok,
         %{
           name: "MAVProxy",
           step: 1,
           ready: nil,
           command: fn source, client, n ->
             outs = for i <- 0..(n - 1), do: "--out=udpin:127.0.0.1:#{client + i}"

             {path,
              [
                "--master=udpin:127.0.0.1:#{source}",
                "--daemon",
                "--non-interactive",
                "--state-basedir=#{System.tmp_dir!()}"
              ] ++ outs}
           end
         }}
    end
  end

  ## Measuring

  defp table(router, context) do
    [first | _] = context.clients

    Enum.reduce(context.clients, nil, fn n, alone ->
      m = measure(router, n, context)

      each =
        if alone && m.rss && n > first, do: max(round((m.rss - alone) / (n - first)), 0), else: ""

      IO.puts(row([router.name, n, m.best, latency(m.slow), latency(m.fast), m.cpu, each]))
      alone || m.rss
    end)
  end

  defp measure(router, n, context) do
    with_router(
      router,
      n,
      "0",
      fn run ->
        slow = run.(1_000)
        fast = run.(10_000)
        rss = run.(:rss)
        best = context.rates |> Enum.take_while(&lossless?(run, &1)) |> List.last()

        cpu =
          if fast["lost"] == 0,
            do: Float.round(fast["cpu"] * 100_000 / fast["sent"], 2),
            else: "#{Float.round(fast["cpu"] * 100_000 / fast["sent"], 2)} (loses)"

        %{slow: slow, fast: fast, rss: rss, best: best || "< #{hd(context.rates)}", cpu: cpu}
      end,
      context
    )
  end

  # A machine that does something else for a moment is not a router's fault: three tries.
  defp lossless?(run, rate) do
    Enum.any?(1..3, fn _ ->
      result = run.({rate, 3})
      result["lost"] == 0 and result["p99"] < 50_000
    end)
  end

  defp latency(%{"lost" => 0} = r), do: "#{r["p50"]} / #{r["p99"]}"

  defp latency(r),
    do: "#{r["p50"]} / #{r["p99"]}, loses #{Float.round(100 * r["lost"] / r["sent"], 1)} %"

  defp with_router(router, n, cores, fun, context, env \\ []) do
    base = base_port()
    {command, args} = router.command.(base, base + 200, n)
    {command, args} = pinned(cores, command, args)
    {command, args} = preferred("nice", ["-n", "-20"], command, args)
    System.put_env("ROUTER_LOAD_VEHICLE", "1")
    if router[:vehicle] == false, do: System.delete_env("ROUTER_LOAD_VEHICLE")

    env =
      for {k, v} <- [{"MIX_ENV", "prod"}] ++ env, do: {to_charlist(k), to_charlist(v)}

    port =
      Port.open({:spawn_executable, command}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: args,
        env: env
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)

    try do
      ready(port, router.ready)
      pid = busiest(pid)

      fun.(fn
        :rss ->
          rss(pid)

        :hundred ->
          load(context, router, base, n, 10_000, 2 * context.seconds, pid, cores, 100, 1)

        {rate, seconds} ->
          load(context, router, base, n, rate, seconds, pid, cores)

        rate ->
          load(context, router, base, n, rate, context.seconds, pid, cores)
      end)
    after
      System.cmd("kill", ["#{pid}"], stderr_to_stdout: true)
      if Port.info(port), do: Port.close(port)
      Process.sleep(300)
    end
  end

  defp ready(_port, nil), do: Process.sleep(3_000)

  defp ready(port, word) do
    receive do
      {^port, {:data, text}} -> if String.contains?(text, word), do: :ok, else: ready(port, word)
      {^port, {:exit_status, status}} -> raise "it ended with #{status}"
    after
      60_000 -> raise "it does not start"
    end
  end

  # A wrapper's child does the work.
  defp busiest(pid) do
    case System.cmd("pgrep", ["-P", "#{pid}"], stderr_to_stdout: true) do
      {children, 0} ->
        [pid | children |> String.split() |> Enum.map(&busiest(String.to_integer(&1)))]
        |> Enum.max_by(&(rss(&1) || 0))

      _none ->
        pid
    end
  end

  defp load(context, router, base, n, rate, seconds, pid, cores, sources \\ 1, step \\ 0) do
    before = cpu(pid)

    args =
      Enum.map([base, base + 200, router.step, n, rate, seconds, sources, step], &to_string/1)

    {command, args} = pinned(if(cores == "0", do: "1", else: cores), context.load, args)
    # Not where router and load share the cores.
    {command, args} =
      if cores == "0", do: preferred("chrt", ["-f", "1"], command, args), else: {command, args}

    {text, 0} = System.cmd(command, args)
    result = JSON.decode!(text)

    Map.merge(result, %{
      "lost" => max(result["sent"] - result["worst"], 0),
      "cpu" => cpu(pid) - before
    })
  end

  defp pinned(cores, command, args) do
    taskset = System.find_executable("taskset")

    if taskset && System.schedulers() > 1,
      do: {taskset, ["-c", cores, command | args]},
      else: {command, args}
  end

  defp preferred(program, options, command, args) do
    root? = match?({"0\n", 0}, System.cmd("id", ["-u"]))
    path = System.find_executable(program)
    if root? && path, do: {path, options ++ [command | args]}, else: {command, args}
  end

  # User and system time, in hundredths of a second.
  defp cpu(pid) do
    [_, rest] = "/proc/#{pid}/stat" |> File.read!() |> String.split(") ", parts: 2)
    fields = String.split(rest)
    (String.to_integer(Enum.at(fields, 11)) + String.to_integer(Enum.at(fields, 12))) / 100
  end

  defp rss(pid) do
    with {:ok, text} <- File.read("/proc/#{pid}/status"),
         [_, kib] <- Regex.run(~r/VmRSS:\s+(\d+)/, text),
         do: String.to_integer(kib),
         else: (_ -> nil)
  end

  # Below the ports that systems give to whoever asks for any: a hundred for links, then those of the clients, then those
  # that the load sends from.
  defp base_port do
    base = 10_000 + 1_000 * :rand.uniform(20)
    if Enum.all?(base..(base + 700), &(free?(&1) == true)), do: base, else: base_port()
  end

  defp free?(port) do
    with {:ok, socket} <- :gen_udp.open(port, ip: {127, 0, 0, 1}),
         do: :gen_udp.close(socket) == :ok
  end

  ## Many links

  defp hundred(context) do
    router = %{
      router_only()
      | command: fn source, client, _n ->
          links = for i <- 0..99, do: "udpin:127.0.0.1:#{source + i}"

          router_node(["udpin:127.0.0.1:#{client}" | links])
        end
    }

    for {name, vehicles} <- [{"routing alone", "1"}, {"with the vehicles' sessions", "250"}] do
      env = [{"ROUTER_BENCH_VEHICLES", vehicles}]
      with_router(router, 1, "0,1", &IO.puts(sentence(name, &1.(:hundred))), context, env)
    end
  end

  defp sentence(name, r) do
    "100 links of 100 frames/s on two cores, #{name}: sent #{r["sent"]}, lost #{r["lost"]}, p50 #{r["p50"]} us, " <>
      "p99 #{r["p99"]} us, CPU #{Float.round(r["cpu"] * 100_000 / r["sent"], 2)} s per 100,000 frames"
  end

  # As the README of the router has it.
  defp row(cells) do
    "| " <>
      ([18, 7, 17, 19, 24, 13, 10]
       |> Enum.zip(cells)
       |> Enum.map_join(" | ", fn {width, cell} -> String.pad_trailing(to_string(cell), width) end)) <>
      " |"
  end
end

RouterBench.main(System.argv())
