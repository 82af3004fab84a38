# How many vehicles a hub holds: vehicles that each say 50 frames a second from a socket of their own, on one UDP port or
# several (a network each), with all that a gateway does with them but NATS; and one that known vehicles share with made-up
# senders. The gateway is one OS process, the load another one, a C program in bench/support; both on all cores.
#
#     mix run bench/hub.exs [--vehicles 20,100,200,500] [--rate 50] [--seconds 10] [--fakes 10000]       or  bin/bench hub
#
# Prints a table in Markdown. Columns: frames other than heartbeats that were sent, received, lost, and of the lost those
# that were counted as dropped; CPU of the gateway's OS process per frame; age of a frame when its vehicle's state is shown,
# from before its `send` on (ms, of ten vehicles, looked at every ms); how many vehicles are known and heard at the end.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

defmodule HubBench do
  # Systems of one network: an id is a byte, and a few are taken.
  @of_network 240

  def main(argv) do
    options =
      MavCodec.Bench.Options.read(__ENV__.file, argv,
        vehicles: "20,100,200,500",
        rate: 50,
        seconds: 10,
        fakes: 10_000
      )

    context = %{
      rate: options[:rate],
      seconds: options[:seconds],
      dir: Path.join(System.tmp_dir!(), "hub-bench-#{System.pid()}")
    }

    File.mkdir_p!(context.dir)

    try do
      context = Map.put(context, :load, compile(context.dir))

      counts =
        for n <- String.split(options[:vehicles], ","),
            do: String.to_integer(n)

      IO.puts(
        "\n" <>
          row(
            [
              "vehicles",
              "links",
              "made up/s",
              "sent",
              "received",
              "lost",
              "counted",
              "CPU us/frame"
            ] ++
              ["p50 / p99 / max ms", "heard"]
          ) <> "\n|" <> String.duplicate("---|", 10)
      )

      for n <- counts, do: measure(context, n, 0)
      for n <- [1, 20], do: measure(context, n, options[:fakes])
      IO.puts("\n#{System.schedulers_online()} cores, load #{load()} at the end")
    after
      File.rm_rf!(context.dir)
    end
  end

  defp compile(dir) do
    out = Path.join(dir, "hub_load")

    cc =
      System.find_executable("cc") || System.find_executable("gcc") ||
        raise "the load needs a C compiler (cc)"

    source = Path.join(__DIR__, "support/hub_load.c")
    {_, 0} = System.cmd(cc, ["-O2", "-pthread", "-o", out, source], into: IO.stream())
    out
  end

  defp measure(context, vehicles, fakes) do
    links = ceil(vehicles / @of_network)
    port = base_port(vehicles)
    script = Path.join(__DIR__, "support/hub_node.exs")
    args = ["run", "--no-compile", script, "#{port}", "#{links}"]

    node =
      Port.open({:spawn_executable, System.find_executable("mix")}, [
        :binary,
        :exit_status,
        args: args
      ])

    try do
      line(node, "ready")
      {:os_pid, pid} = Port.info(node, :os_pid)
      pid = busiest(pid)
      # All vehicles are known before it counts.
      load(context, port, vehicles, links, 5, 0)
      report(node)
      before = cpu(pid)
      sent = load(context, port, vehicles, links, context.seconds, fakes)
      busy = cpu(pid) - before
      print(vehicles, links, fakes, sent, report(node), busy)
    after
      if Port.info(node), do: Port.close(node)
    end
  end

  defp load(context, port, vehicles, links, seconds, fakes) do
    args = Enum.map([port, vehicles, links, context.rate, seconds, fakes], &to_string/1)
    {text, 0} = System.cmd(context.load, args)
    JSON.decode!(text)["sent"]
  end

  defp report(node) do
    Port.command(node, "report\n")
    node |> line("{") |> JSON.decode!()
  end

  defp line(node, start, text \\ "") do
    receive do
      {^node, {:data, more}} ->
        text = text <> more

        found =
          text
          |> String.split("\n")
          |> Enum.drop(-1)
          |> Enum.find(&String.starts_with?(&1, start))

        found || line(node, start, text)

      {^node, {:exit_status, status}} ->
        raise "the gateway ended with #{status}: #{text}"
    after
      120_000 -> raise "the gateway does not answer: #{text}"
    end
  end

  defp print(vehicles, links, fakes, sent, report, busy) do
    lost = sent - report["received"]
    counted = Enum.sum(for name <- ~w(kernel_dropped shed unclaimed overload), do: report[name])
    ages = Enum.map_join(~w(p50 p99 max), " / ", &to_string(report[&1]))
    cost = Float.round(busy * 1_000_000 / max(report["received"], 1), 1)
    heard = if fakes > 0, do: "", else: report["vehicles"]

    IO.puts(row([vehicles, links, fakes, sent, report["received"], lost, counted, cost, ages, heard]))
  end

  # A wrapper's child does the work.
  defp busiest(pid) do
    case System.cmd("pgrep", ["-P", "#{pid}"], stderr_to_stdout: true) do
      {children, 0} ->
        [pid | children |> String.split() |> Enum.map(&busiest(String.to_integer(&1)))]
        |> Enum.max_by(&rss/1)

      _none ->
        pid
    end
  end

  defp rss(pid) do
    with {:ok, text} <- File.read("/proc/#{pid}/status"),
         [_, kib] <- Regex.run(~r/VmRSS:\s+(\d+)/, text),
         do: String.to_integer(kib),
         else: (_ -> 0)
  end

  # Seconds of user and system time.
  defp cpu(pid) do
    [_, rest] = "/proc/#{pid}/stat" |> File.read!() |> String.split(") ", parts: 2)
    fields = String.split(rest)
    (String.to_integer(Enum.at(fields, 11)) + String.to_integer(Enum.at(fields, 12))) / 100
  end

  defp load, do: "/proc/loadavg" |> File.read!() |> String.split() |> hd()

  # The links', and from 1000 on the vehicles'.
  defp base_port(vehicles) do
    base = 10_000 + 2_000 * :rand.uniform(10)

    if Enum.all?(
         Enum.concat(base..(base + 10), (base + 1_000)..(base + 1_000 + vehicles)),
         &free?/1
       ),
       do: base,
       else: base_port(vehicles)
  end

  defp free?(port) do
    with {:ok, socket} <- :gen_udp.open(port, ip: {127, 0, 0, 1}),
         do: :gen_udp.close(socket) == :ok,
         else: (_ -> false)
  end

  defp row(cells) do
    widths = [8, 5, 9, 7, 8, 6, 7, 12, 18, 5]

    "| " <>
      (widths
       |> Enum.zip(cells)
       |> Enum.map_join(" | ", fn {w, c} -> String.pad_trailing(to_string(c), w) end)) <> " |"
  end
end

HubBench.main(System.argv())
