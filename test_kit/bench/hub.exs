# How many vehicles a hub holds: vehicles that each say 50 frames a second from a socket of their own, on one UDP port
# or several (a network each), with all that a gateway does with them but NATS; and one that known vehicles share with
# made-up senders. The gateway is one OS process, the load another one, a C program in support/; both on all cores.
#
#     bin/bench hub [--vehicles 20,100,200,500] [--rate 50] [--seconds 10] [--fakes 10000]
#
# Prints a table in Markdown. Columns: frames other than heartbeats that were sent, received, lost, and of the lost
# those that were counted as dropped; CPU of the gateway's OS process per frame; age of a frame when its vehicle's
# state is shown, from before its `send` on (ms, of ten vehicles, looked at every ms); how many vehicles are known and
# heard at the end.

Code.require_file("harness.exs", __DIR__)

defmodule HubBench do
  alias Bench.{OSProcess, Table, Vehicles}

  @widths [8, 5, 9, 7, 8, 6, 7, 12, 18, 5]

  def main(dir, options) do
    load = OSProcess.compile("vehicle_load", dir)
    numbers = ["sent", "received", "lost", "counted", "CPU us/frame", "p50 / p99 / max ms", "heard"]
    IO.puts("")
    Table.head(["vehicles", "links", "made up/s" | numbers], @widths)
    for n <- Bench.Options.numbers(options[:vehicles]), do: measure(load, n, 0, options)
    for n <- [1, 20], do: measure(load, n, options[:fakes], options)
    Table.machine()
  end

  defp measure(load, count, fakes, options) do
    vehicles = Vehicles.new(load, count, options[:rate])

    OSProcess.with_node(%{urls: vehicles.urls}, fn node, _ready ->
      # All vehicles are known before it counts.
      Vehicles.run(vehicles, 5)
      OSProcess.report(node)
      before = OSProcess.cpus(node).gateway
      sent = Vehicles.run(vehicles, options[:seconds], fakes)
      busy = OSProcess.cpus(node).gateway - before
      %{"received" => received} = report = OSProcess.report(node)
      cost = Float.round(busy * 1_000_000 / max(received, 1), 1)
      heard = if fakes > 0, do: "", else: report["heard"]
      numbers = [sent, received, sent - received, report["dropped"], cost, report["store"], heard]
      Table.row([count, length(vehicles.urls), fakes | numbers], @widths)
    end)
  end
end

options = Bench.Options.read(__ENV__.file, vehicles: "20,100,200,500", rate: 50, seconds: 10, fakes: 10_000)
Bench.Gateway.in_folder("hub", &HubBench.main(&1, options))
