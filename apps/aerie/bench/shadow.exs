# What the shadow costs: the loops of many vehicles that are as desired, each looked at once a second, and how long a vehicle takes to be as
# desired. Everything is one OS process without NATS, links or vehicles that answer: the vehicles are rows of the store, and what is set
# shows in them at once.
#
#     bin/bench shadow [--vehicles 200] [--fields 50] [--seconds 20]
#
# `idle`: nothing is desired. `converged`: a mode and FIELDS parameters, all as desired. CPU is that of the whole VM in per cent of one core.
# `to converge`: from the update on until the report says so, one parameter each of VEHICLES / 10 vehicles (median, longest); and the same with
# a simulated ArduPilot on UDP for a parameter, the mode, and both.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/config.ex", __DIR__)

defmodule ShadowBench do
  alias Aerie.Base.Store
  alias Aerie.Fleet.Shadow

  @gateway :bench

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, vehicles: 200, fields: 50, seconds: 20)
    Logger.configure(level: :error)
    folder = Path.join(System.tmp_dir!(), "shadow-bench-#{System.pid()}")
    File.mkdir_p!(folder)

    try do
      run(folder, options)
    after
      Aerie.Gateway.stop(@gateway)
      File.rm_rf!(folder)
    end
  end

  defp run(folder, options) do
    port = start(folder)
    sims = for n <- 1..3, do: sim(port, n)
    Enum.each(sims, &SimVehicle.await(&1, fn view -> view.ready end))
    until(fn -> length(Store.vehicles(@gateway)) == 3 end)
    loops(options)
    converge()
    IO.puts("\n#{System.schedulers_online()} cores, load #{load()} at the end")
  end

  defp start(folder) do
    config = Aerie.Bench.Config.new(folder, [{"nats.mode", "off"}, {"shadow.hold_s", 0}])
    {:ok, _gateway} = Aerie.Gateway.start_link(name: @gateway, config: config)
    {:ok, _link} = MavRouter.Link.start(@gateway, "udpin:127.0.0.1:0", network: "main")
    until(fn -> port() end)
  end

  defp port, do: Enum.find_value(Store.links(@gateway), & &1[:port])

  defp sim(port, n) do
    {:ok, sim} =
      SimVehicle.start_link(
        link: "udpout:127.0.0.1:#{port}",
        system: n,
        firmware: :ardupilot,
        ready_s: 1.0,
        params: %{"DISARM_DELAY" => 0}
      )

    sim
  end

  ## Loops

  # Rows of the store that are as desired, each with a loop; their vehicles say nothing.
  defp loops(options) do
    %{vehicles: vehicles, fields: fields, seconds: seconds} = Map.new(options)
    base = busy(seconds)
    snapshot = hd(Store.vehicles(@gateway))

    ids =
      for n <- 1..vehicles do
        key = {"loops", n}
        id = "LOOP-#{n}"

        Store.put_vehicle(@gateway, key, %{
          snapshot
          | id: id,
            key: key,
            network: "loops",
            system_id: n,
            links: []
        })

        {:ok, _loop} = Shadow.Loop.start_link(gateway: @gateway, options: %{id: id, key: key})
        id
      end

    idle = busy(seconds)
    mode = snapshot.groups.mode.data.mode

    for id <- ids do
      params = Map.new(1..fields, &{"BENCH_#{&1}", &1 * 1.0})
      Aerie.Vehicle.Journal.commit(@gateway, id, nil, [], params)
      desire(id, %{"mode" => mode, "params" => params})
    end

    all = fields + 1

    until(fn ->
      Enum.all?(
        ids,
        &(Enum.count(Shadow.report(@gateway, &1), fn {_path, s} -> s.state == :converged end) == all)
      )
    end)

    looks = Store.counter(@gateway, {:shadow, :reconciliations})
    converged = busy(seconds)
    looks = Store.counter(@gateway, {:shadow, :reconciliations}) - looks
    # Also right when the machine is too busy for a look a second.
    each = round((converged - idle) * seconds * 10_000 / max(looks, 1))

    IO.puts("\n| loops | fields of each | CPU without them | idle | converged | looks | us of CPU each |")
    IO.puts("|---|---|---|---|---|---|---|")
    IO.puts("| #{vehicles} | #{all} | #{base} % | #{idle} % | #{converged} % | #{looks} | #{each} |")
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
    {before, _} = :erlang.statistics(:runtime)
    Process.sleep(seconds * 1000)
    {now, _} = :erlang.statistics(:runtime)
    Float.round((now - before) / seconds / 10, 1)
  end

  ## A simulated vehicle

  defp converge do
    IO.puts("\n| to converge, simulated ArduPilot | median of 10 | longest |\n|---|---|---|")
    id = hd(Store.vehicles(@gateway) |> Enum.filter(&(&1.network == "main"))).id
    times("a parameter", id, fn n -> %{"params" => %{"WPNAV_SPEED" => 500 + n}} end)
    modes = {"GUIDED", "LOITER"}
    times("the mode", id, fn n -> %{"mode" => elem(modes, rem(n, 2))} end)

    times("ten parameters, then the mode", id, fn n ->
      names =
        ~w(WPNAV_SPEED WPNAV_ACCEL WPNAV_RADIUS RTL_ALT FENCE_ALT_MAX FENCE_RADIUS FS_GCS_ENABLE LOIT_SPEED BATT_LOW_MAH LAND_SPEED)

      %{"params" => Map.new(names, &{&1, 100 + n}), "mode" => elem(modes, rem(n, 2))}
    end)
  end

  defp times(what, id, desired) do
    ms =
      for n <- 1..10 do
        wanted = desired.(n)
        started = System.monotonic_time(:millisecond)
        version = desire(id, wanted)

        until(fn ->
          report = Shadow.report(@gateway, id)
          {_fields, document} = Shadow.Documents.reported(@gateway, id)

          document["desired_version"] >= version and report != %{} and
            Enum.all?(report, fn {_path, status} -> status.state in [:converged, :refused] end)
        end)

        System.monotonic_time(:millisecond) - started
      end

    sorted = Enum.sort(ms)
    IO.puts("| #{what} | #{Enum.at(sorted, 5)} ms | #{List.last(sorted)} ms |")
  end

  defp until(fun) do
    case fun.() do
      found when found in [nil, false] ->
        Process.sleep(5)
        until(fun)

      found ->
        found
    end
  end

  defp load, do: "/proc/loadavg" |> File.read!() |> String.split() |> hd()
end

ShadowBench.main(System.argv())
