# What a frame costs in each part of a whole gateway: the vehicle's messages come by UDP, with NATS, recorder and
# console as the defaults have them.
#
#     bin/bench parts [--vehicles 20] [--rate 50] [--seconds 10]
#
# Prints two tables in Markdown. The first one: reductions per frame of the processes of each kind (by their labels),
# those of the NATS server left out, and the CPU of the whole program in microseconds per frame. The second one: what a
# few steps take by themselves, one after the other on a warm core, in microseconds and reductions; each is the best of
# five.

Code.require_file("harness.exs", __DIR__)

defmodule PartsBench do
  alias Aerie.Base.Store
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Tracks
  alias Bench.{Gateway, OSProcess, Sample, Vehicles}
  alias Aerie.Console.Pages.Fleet.Table
  alias Aerie.Console.Pages.Fleet.Board.Row

  @gateway :bench
  @settle_s 5
  @rounds 5
  @times 2_000

  def main(dir, options) do
    vehicles = Vehicles.new(OSProcess.compile("vehicle_load", dir), options[:vehicles], options[:rate], 1)
    off = [{"sockets.enabled", false}, {"websocket.enabled", false}, {"nats.port", 0}, {"http.port", 0}]
    Gateway.whole(@gateway, Gateway.config(dir, off), true)
    for {url, n} <- Enum.with_index(vehicles.urls), do: Gateway.link(@gateway, url, network: "n#{n}")
    Vehicles.run(vehicles, @settle_s)
    before = reductions()
    cpu = Sample.cpu()
    frames = Vehicles.run(vehicles, options[:seconds])
    cpu = Sample.cpu() - cpu
    table(before, reductions(), frames)
    IO.puts("\n#{round(cpu * 1_000_000 / frames)} us of CPU a frame\n")
    steps()
    Bench.Table.machine()
  end

  # Of all processes of each kind.
  defp reductions do
    for pid <- Process.list(),
        pid != self(),
        {:reductions, n} <- [Process.info(pid, :reductions)],
        reduce: %{} do
      kinds -> Map.update(kinds, kind(pid), n, &(&1 + n))
    end
  end

  defp kind(pid) do
    case Process.info(pid, :label) do
      {:label, label} when is_tuple(label) -> elem(label, 0)
      {:label, label} when is_atom(label) and label not in [nil, :undefined] -> label
      _none -> :others
    end
  end

  defp table(before, now, frames) do
    Bench.Table.head(["processes", "reductions a frame"])
    costs = for {kind, n} <- now, do: {kind, (n - Map.get(before, kind, 0)) / frames}

    for {kind, cost} <- Enum.sort_by(costs, &(-elem(&1, 1))),
        cost >= 0.5,
        do: Bench.Table.row([kind, round(cost)])
  end

  # Each is the first one of a minute, which is the most that a second costs.
  defp second(now) do
    samples =
      for vehicle <- Aerie.Fleet.vehicles(@gateway), do: {vehicle.id, Tracks.Sample.of(vehicle, [], now)}

    Tracks.Core.handle(Tracks.Core.new(), {:tick, div(now, 1000), samples})
  end

  defp steps do
    Bench.Table.head(["step", "us", "reductions"])
    [vehicle | _others] = Store.vehicles(@gateway)
    now = System.os_time(:microsecond)
    group = vehicle.groups.attitude
    row = Row.new(vehicle, Store.links(@gateway), %{}, now, %{})
    text = &Message.state(vehicle.id, "attitude", &1.data, &1.time_boot_ms, &1.at, %{epoch: 1, gateway: "g"})

    for {name, fun} <- [
          {"store: write a vehicle's snapshot", fn -> Store.put_vehicle(@gateway, vehicle.key, vehicle) end},
          {"store: read a vehicle's snapshot", fn -> Store.vehicle(@gateway, vehicle.key) end},
          {"NATS: the text of a state group", fn -> text.(group) end},
          {"console: a row of the fleet's table", fn -> Row.new(vehicle, [], %{}, now, %{}) end},
          {"console: its rendered line", fn -> Table.line(row) end},
          {"tracks: a second of all vehicles", fn -> second(now) end}
        ] do
      repeated = fn -> Enum.each(1..@times, fn _time -> fun.() end) end
      best = Task.async(fn -> Enum.min(for _round <- 1..@rounds, do: Sample.cost(repeated)) end)
      {us, reductions, :ok} = Task.await(best, 60_000)
      Bench.Table.row([name, Float.round(us / @times, 1), round(reductions / @times)])
    end
  end
end

options = Bench.Options.read(__ENV__.file, vehicles: 20, rate: 50, seconds: 10)
Bench.Gateway.in_folder("parts", &PartsBench.main(&1, options))
