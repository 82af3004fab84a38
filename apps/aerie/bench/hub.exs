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
Code.require_file("support/os_process.ex", __DIR__)

defmodule HubBench do
  alias Aerie.Bench.OSProcess

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
      context =
        Map.put(
          context,
          :load,
          OSProcess.compile(Path.join(__DIR__, "support/hub_load.c"), Path.join(context.dir, "hub_load"))
        )

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
      IO.puts("\n#{System.schedulers_online()} cores, load #{OSProcess.load()} at the end")
    after
      File.rm_rf!(context.dir)
    end
  end

  defp measure(context, vehicles, fakes) do
    links = ceil(vehicles / @of_network)
    port = OSProcess.base_port(vehicles)
    script = Path.join(__DIR__, "support/hub_node.exs")

    node = OSProcess.start(["run", "--no-compile", script, "#{port}", "#{links}"])

    try do
      OSProcess.line(node, "ready")
      # All vehicles are known before it counts.
      load(context, port, vehicles, links, 5, 0)
      report(node)
      before = OSProcess.cpus(node).gateway
      sent = load(context, port, vehicles, links, context.seconds, fakes)
      busy = OSProcess.cpus(node).gateway - before
      print(vehicles, links, fakes, sent, report(node), busy)
    after
      OSProcess.stop(node)
    end
  end

  defp load(context, port, vehicles, links, seconds, fakes) do
    args = Enum.map([port, vehicles, links, context.rate, seconds, fakes], &to_string/1)
    {text, 0} = System.cmd(context.load, args)
    JSON.decode!(text)["sent"]
  end

  defp report(node), do: node |> OSProcess.ask("report", "{") |> JSON.decode!()

  defp print(vehicles, links, fakes, sent, report, busy) do
    lost = sent - report["received"]
    counted = Enum.sum(for name <- ~w(kernel_dropped shed unclaimed overload), do: report[name])
    ages = Enum.map_join(~w(p50 p99 max), " / ", &to_string(report[&1]))
    cost = Float.round(busy * 1_000_000 / max(report["received"], 1), 1)
    heard = if fakes > 0, do: "", else: report["vehicles"]

    IO.puts(row([vehicles, links, fakes, sent, report["received"], lost, counted, cost, ages, heard]))
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
