# What the gateway costs aboard a vehicle: one vehicle on a serial port (a pseudo terminal), the embedded nats-server,
# the defaults of bin/run, its output in a file.
#
#     bin/bench companion [--rates 0,10,50] [--seconds 60]
#
# The table, for each number of frames a second (0: no vehicle): CPU of the gateway's VM and of nats-server in
# per cent of one core, their memory (proportional set size, MB), and what they write to the disk (MB an hour) after 15
# s of settling. What its start costs: `bin/bench start`.

Code.require_file("harness.exs", __DIR__)

defmodule CompanionBench do
  alias Bench.{BinRun, OSProcess, Table}

  def main(dir, options) do
    load = OSProcess.compile("serial_load", dir)

    Table.head([
      "frames/s",
      "CPU %",
      "CPU % NATS",
      "MB",
      "MB NATS",
      "MB/h written",
      "MB/h NATS",
      "MB/h output"
    ])

    for rate <- Bench.Options.numbers(options[:rates]),
        do: running(Path.join(dir, "rate-#{rate}"), load, rate, options[:seconds])

    Table.machine()
  end

  defp running(dir, load, rate, seconds) do
    BinRun.with_vehicle(load, rate, fn url ->
      gateway = BinRun.start(dir, url)
      BinRun.until(gateway, if(rate > 0, do: :online, else: :ready))
      # First pages, indexes and journals are written once.
      Process.sleep(15_000)
      before = BinRun.usage(gateway)
      Process.sleep(seconds * 1_000)
      now = BinRun.usage(gateway)
      BinRun.kill(gateway)
      each = fn path -> (get_in(now, path) - get_in(before, path)) / seconds end
      cpu = for part <- [:vm, :nats], do: Float.round(each.([part, :cpu]) * 100, 2)
      memory = for part <- [:vm, :nats], do: round(now[part].memory / 1.0e6)

      written =
        for path <- [[:vm, :written], [:nats, :written], [:output]],
            do: Float.round(each.(path) * 3_600 / 1.0e6, 2)

      Table.row([rate] ++ cpu ++ memory ++ written)
    end)
  end
end

options = Bench.Options.read(__ENV__.file, rates: "0,10,50", seconds: 60)
Bench.Gateway.in_folder("companion", &CompanionBench.main(&1, options))
