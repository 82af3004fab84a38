# What a hub receives when vehicles say more than it can read: 1, 2, 5 and 10 times what the machine just holds, alone
# and beside busy loops that compete for the processors.
#
#     bin/bench overload [--vehicles 200] [--times 1,2,5,10] [--loops 0,8] [--rate 0] [--seconds 8]
#
# Every vehicle says its frames from a socket of its own, as in `hub`; a higher load is the same vehicles at a higher
# rate. --rate is the rate of one time (frames/s of a vehicle); 0 looks for the highest at which no more than 1 % is
# lost. The load runs at a higher priority where that is allowed (root): vehicles do not slow down because a gateway's
# machine is busy. Linux with autogroups ignores that: there the load has a share like each loop, and may say less.
#
# Columns: times what the machine holds; busy loops; frames other than heartbeats that were sent and received in a
# second, the part that was lost and the part of it that was counted as dropped; age of a frame when its vehicle's state
# is shown, as in `hub`; CPU of the gateway in per cent of a core, per frame received, and per datagram discarded (what
# it used beyond what its frames cost at one time without loops; frames that are read together cost less, so it may be
# 0). Then a plot, for docs/hub.md, and the line that `bin/bench --check` reads.

Code.require_file("harness.exs", __DIR__)

defmodule OverloadBench do
  alias Bench.{OSProcess, Table, Vehicles}

  @rates [5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160]
  @bar 60

  def main(dir, options) do
    load = OSProcess.compile("vehicle_load", dir)
    rate = if options[:rate] > 0, do: options[:rate], else: held(load, options[:vehicles])
    IO.puts("\n#{options[:vehicles]} vehicles; the machine holds #{rate} frames/s of each\n")

    Table.head([
      "times",
      "loops",
      "sent/s",
      "received/s",
      "lost",
      "counted",
      "p50 / p99 / max ms",
      "CPU",
      "us/frame",
      "us/discarded"
    ])

    rows =
      for loops <- Bench.Options.numbers(options[:loops]),
          times <- Bench.Options.numbers(options[:times]),
          reduce: [] do
        rows -> rows ++ [row(measure(load, options, rate * times, loops), times, loops, rows)]
      end

    plot(rows)
    kept(rows)
    Table.machine()
  end

  # The highest rate without loss.
  defp held(load, count) do
    @rates
    |> Enum.take_while(fn rate ->
      %{sent: sent, received: received} = measure(load, [vehicles: count, seconds: 5], rate, 0)
      received >= 0.99 * sent
    end)
    |> List.last(hd(@rates))
  end

  defp measure(load, options, rate, loops) do
    vehicles = Vehicles.new(load, options[:vehicles], rate)

    OSProcess.with_node(%{urls: vehicles.urls}, fn node, _ready ->
      # All vehicles are known before it counts, and an overload has begun.
      Vehicles.run(%{vehicles | rate: min(rate, 10)}, 5)
      loops = for _n <- 1..loops//1, do: busy()
      Vehicles.run(vehicles, 4)
      OSProcess.report(node)
      before = OSProcess.cpus(node).gateway
      %{"sent" => sent, "seconds" => seconds} = Vehicles.offer(vehicles, options[:seconds])
      cpu = OSProcess.cpus(node).gateway - before
      Enum.each(loops, &stop/1)
      report = OSProcess.report(node)
      %{sent: sent, seconds: seconds, cpu: cpu, received: report["received"], report: report}
    end)
  end

  defp busy do
    args = ["-c", "while :; do :; done"]
    port = Port.open({:spawn_executable, "/bin/sh"}, args: args)
    port |> Port.info(:os_pid) |> elem(1)
  end

  defp stop(pid), do: System.cmd("kill", ["#{pid}"])

  defp row(%{sent: sent, received: received, report: report} = found, times, loops, rows) do
    lost = max(sent - received, 0)
    us = found.cpu * 1_000_000 / max(received, 1)
    # A frame's own cost, from the first row.
    own = if rows == [], do: us, else: hd(rows).us
    discarded = if lost > 0.1 * sent, do: max(found.cpu * 1_000_000 - received * own, 0) / lost
    row = %{times: times, loops: loops, received: received / found.seconds, us: us, discarded: discarded}

    Table.row([
      times,
      loops,
      round(sent / found.seconds),
      round(row.received),
      "#{Float.round(lost * 100 / sent, 1)} %",
      "#{min(round(report["dropped"] * 100 / max(lost, 1)), 100)} %",
      report["store"],
      "#{round(found.cpu * 100 / found.seconds)} %",
      Float.round(us, 1),
      discarded && Float.round(discarded, 1)
    ])

    row
  end

  defp plot(rows) do
    most = rows |> Enum.map(& &1.received) |> Enum.max()
    IO.puts("\n```\ntimes  loops  frames received in a second")

    for row <- rows do
      bar = String.duplicate("█", round(row.received * @bar / most))

      Table.columns([row.times, "  ", row.loops, "  ", bar, " ", round(row.received)], [-5, 0, -5, 0, 0, 0, 0])
    end

    IO.puts("```\n")
  end

  defp kept([%{received: first} | _] = rows) do
    alone = Enum.filter(rows, &(&1.loops == 0))
    least = alone |> Enum.map(& &1.received) |> Enum.min()
    IO.puts("received at one time, of 100 at the worst overload: #{round(first * 100 / max(least, 1))}")
  end
end

options =
  Bench.Options.read(__ENV__.file, vehicles: 200, times: "1,2,5,10", loops: "0,8", rate: 0, seconds: 8)

Bench.Gateway.in_folder("overload", &OverloadBench.main(&1, options))
