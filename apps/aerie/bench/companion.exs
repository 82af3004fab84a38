# What the gateway costs aboard a vehicle: one vehicle on a serial port (a pseudo terminal), the embedded nats-server, the defaults of
# bin/run, its output in a file.
#
#     bin/bench companion [--rates 0,10,50] [--seconds 60] [--rounds 3]
#
# The first table, for each number of frames a second (0: no vehicle): CPU of the gateway's VM and of nats-server in per cent of one
# core, their memory (proportional set size, MB), and what they write to the disk (MB an hour) after 15 s of settling. The second
# one, of so many rounds: seconds until /readyz says ready, CPU seconds until the gateway is quiet (less than 5 % of a core for a
# second), and seconds from `kill -9` in flight until the vehicle is online again.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/os_process.ex", __DIR__)
Code.require_file("support/companion.ex", __DIR__)

defmodule CompanionBench do
  alias Aerie.Bench.{Companion, OSProcess}

  @defaults [rates: "0,10,50", seconds: 60, rounds: 3]

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, @defaults)
    dir = Path.join(System.tmp_dir!(), "companion-bench-#{System.pid()}")
    File.mkdir_p!(dir)

    try do
      load = OSProcess.compile(Path.join(__DIR__, "support/serial_load.c"), Path.join(dir, "serial_load"))
      row(["frames/s", "CPU %", "CPU % NATS", "MB", "MB NATS", "MB/h written", "MB/h NATS", "MB/h output"])
      IO.puts("|" <> String.duplicate("---|", 8))

      for rate <- options[:rates] |> String.split(",", trim: true) |> Enum.map(&String.to_integer/1),
          do: running(Path.join(dir, "rate-#{rate}"), load, rate, options[:seconds])

      IO.puts("")
      row(["round", "ready s", "CPU s until quiet", "online again after kill -9 s"])
      IO.puts("|" <> String.duplicate("---|", 4))
      restarts(Path.join(dir, "restarts"), load, options[:rounds])
      IO.puts("\n#{System.schedulers_online()} cores, load #{OSProcess.load()} at the end")
    after
      File.rm_rf!(dir)
    end
  end

  defp running(dir, load, rate, seconds) do
    Companion.with_vehicle(load, rate, fn device ->
      gateway = Companion.start(dir, device)

      try do
        Companion.ready(gateway)
        if rate > 0, do: Companion.online(gateway)
        # First pages, indexes and journals are written once.
        Process.sleep(15_000)
        before = Companion.usage(gateway)
        Process.sleep(seconds * 1_000)
        now = Companion.usage(gateway)
        each = fn path -> get_in(now, path) - get_in(before, path) end
        cpu = &Float.round(each.([&1, :cpu]) / seconds * 100, 2)
        hourly = &Float.round(each.(&1) / seconds * 3_600 / 1.0e6, 2)

        row([
          rate,
          cpu.(:vm),
          cpu.(:nats),
          round(now.vm.memory / 1.0e6),
          round(now.nats.memory / 1.0e6),
          hourly.([:vm, :written]),
          hourly.([:nats, :written]),
          hourly.([:output])
        ])
      after
        Companion.kill(gateway)
      end
    end)
  end

  defp restarts(dir, load, rounds) do
    Companion.with_vehicle(load, 50, fn device ->
      for round <- 1..rounds do
        gateway = Companion.start(dir, device)
        ready = Companion.ready(gateway)
        cpu = Companion.quiet(gateway)
        Companion.online(gateway)
        Companion.kill(gateway)
        again = Companion.start(dir, device)
        back = Companion.online(again)
        Companion.kill(again)
        row([round, ready, cpu, back])
      end
    end)
  end

  defp row(cells), do: IO.puts("| " <> Enum.map_join(cells, " | ", &to_string/1) <> " |")
end

CompanionBench.main(System.argv())
