# What the shadow costs: the loops of many vehicles that are as desired, each looked at once a second, and how long a
# vehicle takes to be as desired. Everything is one OS process without NATS, links or vehicles that answer: the
# vehicles are rows of the store, and what is set shows in them at once.
#
#     bin/bench shadow [--vehicles 200] [--fields 50] [--seconds 20]
#
# `idle`: nothing is desired. `converged`: a mode and FIELDS parameters, all as desired. CPU is that of the whole VM in
# per cent of one core. `to converge`: from the update on until the report says so, one parameter each of VEHICLES / 10
# vehicles (median, longest); and the same with a simulated ArduPilot on UDP for a parameter, the mode, and both.

Code.require_file("harness.exs", __DIR__)

defmodule ShadowBench do
  import Bench.Sample, only: [until: 1]

  alias Aerie.Base.Store
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Events.Journal
  alias Bench.{Gateway, Sample, Table}

  @gateway :bench
  @names ~w(WPNAV_SPEED WPNAV_ACCEL WPNAV_RADIUS RTL_ALT FENCE_ALT_MAX FENCE_RADIUS FS_GCS_ENABLE LOIT_SPEED) ++
           ~w(BATT_LOW_MAH LAND_SPEED)

  def main(folder, options) do
    Gateway.whole(@gateway, Gateway.config(folder, [{"nats.mode", "off"}, {"shadow.hold_s", 0}]))
    port = Gateway.link(@gateway, "udpin:127.0.0.1:0", network: "main")
    sims = for n <- 1..3, do: Gateway.sim(port, system: n, ready_s: 1.0, params: %{"DISARM_DELAY" => 0})
    Enum.each(sims, &SimVehicle.await(&1, fn view -> view.ready end))
    until(fn -> length(Store.vehicles(@gateway)) == 3 end)
    loops(options)
    converge()
    Table.machine()
    Aerie.Gateway.stop(@gateway)
  end

  ## Loops

  # Rows of the store that are as desired, each with a loop; their vehicles say nothing.
  defp loops(%{vehicles: vehicles, fields: fields, seconds: seconds}) do
    base = busy(seconds)
    snapshot = hd(Store.vehicles(@gateway))
    ids = for n <- 1..vehicles, do: vehicle(snapshot, {"loops", n}, "LOOP-#{n}")
    idle = busy(seconds)

    for id <- ids do
      params = Map.new(1..fields, &{"BENCH_#{&1}", &1 * 1.0})
      Journal.commit(@gateway, id, nil, [], params)
      desire(id, %{"mode" => snapshot.groups.mode.data.mode, "params" => params})
    end

    all = fields + 1

    converged? = fn id ->
      Enum.count(Shadow.report(@gateway, id), fn {_path, s} -> s.state == :converged end) == all
    end

    until(fn -> Enum.all?(ids, converged?) end)
    looks = Store.counter(@gateway, {:shadow, :reconciliations})
    converged = busy(seconds)
    looks = Store.counter(@gateway, {:shadow, :reconciliations}) - looks
    # Also right when the machine is too busy for a look a second.
    each = round((converged - idle) * seconds * 10_000 / max(looks, 1))
    IO.puts("")

    Table.head([
      "loops",
      "fields of each",
      "CPU without them",
      "idle",
      "converged",
      "looks",
      "us of CPU each"
    ])

    Table.row([vehicles, all, "#{base} %", "#{idle} %", "#{converged} %", looks, each])
  end

  defp vehicle(snapshot, {network, n} = key, id) do
    fields = %{id: id, key: key, network: network, system_id: n, links: []}
    Store.put_vehicle(@gateway, key, Map.merge(snapshot, fields))
    {:ok, _loop} = Shadow.Loop.start_link(gateway: @gateway, options: %{id: id, key: key})
    id
  end

  # In a name of its own, because each may change ten desired states a second.
  defp desire(id, desired) do
    source = %{name: "bench-#{System.unique_integer([:positive])}", role: :admin, permissions: []}

    case Shadow.update(@gateway, id, %{"desired" => desired}, source) do
      {:ok, %{"version" => version}} -> version
      # The copies on the disk take longer than a caller waits.
      {:error, {:unavailable, _why}} -> desire(id, desired)
    end
  end

  defp busy(seconds) do
    before = Sample.cpu()
    Process.sleep(seconds * 1000)
    Float.round((Sample.cpu() - before) / seconds * 100, 1)
  end

  ## A simulated vehicle

  defp converge do
    IO.puts("")
    Table.head(["to converge, simulated ArduPilot", "median of 10", "longest"])
    id = Enum.find(Store.vehicles(@gateway), &(&1.network == "main")).id
    mode = &Enum.at(["GUIDED", "LOITER"], rem(&1, 2))

    for {what, desired} <- [
          {"a parameter", &%{"params" => %{"WPNAV_SPEED" => 500 + &1}}},
          {"the mode", &%{"mode" => mode.(&1)}},
          {"ten parameters, then the mode",
           &%{"params" => Map.new(@names, fn name -> {name, 100 + &1} end), "mode" => mode.(&1)}}
        ] do
      times = for n <- 1..10, do: round(Sample.ms(fn -> converged(id, desire(id, desired.(n))) end))
      Table.row([what, "#{Sample.median(times)} ms", "#{Enum.max(times)} ms"])
    end
  end

  defp converged(id, version) do
    until(fn ->
      report = Shadow.report(@gateway, id)
      {_fields, document} = Shadow.Documents.reported(@gateway, id)

      document["desired_version"] >= version and report != %{} and
        Enum.all?(report, fn {_path, status} -> status.state in [:converged, :refused] end)
    end)
  end
end

options = Map.new(Bench.Options.read(__ENV__.file, vehicles: 200, fields: 50, seconds: 20))
Bench.Gateway.in_folder("shadow", &ShadowBench.main(&1, options))
