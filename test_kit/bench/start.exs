# What a start costs: a vehicle of 50 frames a second on a serial port (a pseudo terminal), the embedded nats-server,
# the defaults of bin/run.
#
#     bin/bench start [--rounds 5] [--sim 0] [--program PATH]
#
# Each round starts a gateway, lets it settle for 15 s, kills it with `kill -9` in flight, and starts it again: seconds
# until /readyz says ready, CPU seconds until the gateway is quiet (less than 5 % of a core for a second), memory
# (proportional set size, MB) of the gateway's VM and of nats-server, the modules that are loaded, and seconds from the
# second start until the vehicle is online again. `--sim` adds simulated vehicles; `--program` is the bin/aerie of an
# unpacked release (default: this checkout's bin/run).

Code.require_file("harness.exs", __DIR__)

defmodule StartBench do
  alias Bench.{BinRun, OSProcess, Sample, Table}

  @head ["round", "ready s", "CPU s until quiet", "MB", "MB NATS", "modules", "online again s"]

  def main(dir, options) do
    load = OSProcess.compile("serial_load", dir)
    Table.head(@head)

    rounds =
      BinRun.with_vehicle(load, 50, fn url ->
        for n <- 1..options[:rounds], do: round(Path.join(dir, "gateway"), url, options, n)
      end)

    if options[:rounds] > 1, do: Table.row(["median" | rounds |> Enum.zip_with(&Sample.median/1)])
    Table.machine()
  end

  defp round(dir, url, options, n) do
    gateway = BinRun.start(dir, url, options)
    ready = BinRun.until(gateway, :ready)
    cpu = BinRun.quiet(gateway)
    BinRun.until(gateway, :online)
    # The flight whose memory and modules are measured: a duration, not a wait for something.
    Process.sleep(15_000)
    %{vm: vm, nats: nats} = BinRun.usage(gateway)
    modules = BinRun.rpc(gateway, "length(:code.all_loaded())")
    BinRun.kill(gateway)
    again = BinRun.start(dir, url, options)
    online = BinRun.until(again, :online)
    BinRun.kill(again)
    memory = for %{memory: bytes} <- [vm, nats], do: round(bytes / 1.0e6)
    row = [seconds(ready), Float.round(cpu, 2)] ++ memory ++ [String.to_integer(modules), seconds(online)]
    Table.row([n | row])
    row
  end

  defp seconds(ms), do: Float.round(ms / 1000, 2)
end

options = Bench.Options.read(__ENV__.file, rounds: 5, sim: 0, program: "")
Bench.Gateway.in_folder("start", &StartBench.main(&1, options))
