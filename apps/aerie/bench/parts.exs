# What a frame costs in each part of a whole gateway: the vehicle's messages come by UDP, with NATS, recorder and console as the defaults have them.
#
#     bin/bench parts [--vehicles 20] [--rate 50] [--seconds 10]
#
# Prints two tables in Markdown. The first one: reductions per frame of the processes of each kind (by their labels), those of the NATS
# server left out, and the CPU of the whole program in microseconds per frame. The second one: what a few steps take by themselves, one after the
# other on a warm core, in microseconds and reductions; each is the best of five.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("../../mav_codec/bench/support/flight_messages.ex", __DIR__)
Code.require_file("../../mav_codec/bench/support/telemetry_mix.ex", __DIR__)
Code.require_file("support/os_process.ex", __DIR__)

defmodule PartsBench do
  @moduledoc false
  alias Aerie.Base.Store
  alias Aerie.Bench.OSProcess
  alias Aerie.Fleet.Bridge.Message
  alias FleetWeb.Console.Fleet.{Row, Table}

  @settle_s 5
  @rounds 5
  @times 2_000

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, vehicles: 20, rate: 50, seconds: 10)
    Logger.configure(level: :error)
    dir = Path.join(System.tmp_dir!(), "parts-bench-#{System.pid()}")
    File.mkdir_p!(dir)

    try do
      load = OSProcess.compile(Path.join(__DIR__, "support/hub_load.c"), Path.join(dir, "hub_load"))
      port = OSProcess.base_port(options[:vehicles])
      gateway = start(dir, port)
      send_frames(load, port, options, @settle_s)
      before = counted()
      sent = send_frames(load, port, options, options[:seconds])
      table(before, counted(), sent)
      steps(gateway)
      IO.puts("\n#{System.schedulers_online()} cores, load #{OSProcess.load()} at the end")
    after
      File.rm_rf!(dir)
    end
  end

  defp start(dir, port) do
    {:ok, config} =
      Aerie.Config.load(nil, %{
        "nats" => %{"port" => 0, "store_dir" => Path.join(dir, "nats")},
        "outbox" => %{"dir" => Path.join(dir, "outbox")},
        "mavlink" => %{"local_addr" => "off"},
        "sockets" => %{"enabled" => false},
        "clients" => [],
        "http" => %{"port" => 0},
        "websocket" => %{"enabled" => false},
        "console" => %{"dir" => Path.join(dir, "console")},
        "recorder" => %{"dir" => Path.join(dir, "recordings")},
        "shadow" => %{"dir" => Path.join(dir, "shadow")},
        "policy" => %{"audit" => %{"dir" => Path.join(dir, "audit")}},
        "commands" => %{"ledger" => %{"dir" => Path.join(dir, "ledger")}}
      })

    {:ok, _gateway} = Aerie.Gateway.start_link(name: :bench, config: config)
    {:ok, _endpoint} = FleetWeb.Endpoint.start_link(gateway: :bench, settings: FleetWeb.Settings.from(config))
    {:ok, _link} = MavRouter.Link.start(:bench, "udpin:127.0.0.1:#{port}", network: "n0")
    :bench
  end

  defp send_frames(load, port, options, seconds) do
    args = Enum.map([port, options[:vehicles], 1, options[:rate], seconds, 0, 1], &to_string/1)
    {text, 0} = System.cmd(load, args)
    JSON.decode!(text)["sent"]
  end

  # CPU in ms, and the reductions of all processes of each kind.
  defp counted do
    {cpu_ms, _since} = :erlang.statistics(:runtime)

    reductions =
      for pid <- Process.list(),
          pid != self(),
          {:reductions, n} <- [Process.info(pid, :reductions)],
          reduce: %{} do
        kinds -> Map.update(kinds, kind(pid), n, &(&1 + n))
      end

    {cpu_ms, reductions}
  end

  defp kind(pid) do
    case Process.info(pid, :label) do
      {:label, label} when is_tuple(label) -> elem(label, 0)
      {:label, label} when is_atom(label) and label not in [nil, :undefined] -> label
      _none -> :others
    end
  end

  defp table({cpu_before, before}, {cpu_after, after_all}, frames) do
    IO.puts("| processes | reductions a frame |\n|---|---|")
    costs = for {kind, n} <- after_all, do: {kind, (n - Map.get(before, kind, 0)) / frames}

    for {kind, cost} <- Enum.sort_by(costs, &(-elem(&1, 1))),
        cost >= 0.5,
        do: IO.puts("| #{kind} | #{round(cost)} |")

    IO.puts("\n#{round((cpu_after - cpu_before) * 1_000 / frames)} us of CPU a frame\n")
  end

  defp steps(gateway) do
    IO.puts("| step | us | reductions |\n|---|---|---|")
    [vehicle | _others] = Store.vehicles(gateway)
    now = System.os_time(:microsecond)
    group = vehicle.groups.attitude
    row = Row.new(vehicle, Store.links(gateway), %{}, now, %{})

    for {name, fun} <- [
          {"store: write a vehicle's snapshot", fn -> Store.put_vehicle(gateway, vehicle.key, vehicle) end},
          {"store: read a vehicle's snapshot", fn -> Store.vehicle(gateway, vehicle.key) end},
          {"NATS: the text of a state group",
           fn ->
             Message.state(vehicle.id, "attitude", group.data, group.time_boot_ms, group.at, %{
               epoch: 1,
               gateway: "g"
             })
           end},
          {"console: a row of the fleet's table", fn -> Row.new(vehicle, [], %{}, now, %{}) end},
          {"console: its rendered cells", fn -> Table.cells(row) end}
        ],
        do: step(name, fun)
  end

  defp step(name, fun) do
    {us, reductions} =
      Task.await(Task.async(fn -> Enum.min(for _round <- 1..@rounds, do: once(fun)) end), 60_000)

    IO.puts("| #{name} | #{Float.round(us / @times, 1)} | #{round(reductions / @times)} |")
  end

  defp once(fun) do
    {:reductions, before} = Process.info(self(), :reductions)
    {us, _done} = :timer.tc(fn -> for _time <- 1..@times, do: fun.() end)
    {:reductions, now} = Process.info(self(), :reductions)
    {us, now - before}
  end
end

PartsBench.main(System.argv())
