# What a command costs on its way to a vehicle: the policy, the executor, the pipeline around them (ledger, audit log,
# rates), and each step of the pipeline by itself.
#
#     bin/bench commands [--commands 5000] [--dir FOLDER]
#
# Each line is that many single calls (of the executor at most 1,020), one after the other: median, p99 and the
# longest, in microseconds. The fence has 100 corners. `executor` is a command to a vehicle that acknowledges at once:
# submit to result, with the way to the session and back. `pipeline` is submit to result with an executor that answers
# at once; takeoff must reach the disk before it is sent, because it is never sent twice. Last, 1, 5 and 20 ground
# stations ask for all parameters of a simulated vehicle at once, with and without `served`: what the vehicle had to
# send. FOLDER is on the disk whose writes count (the system's temporary folder unless given).

Code.require_file("harness.exs", __DIR__)

defmodule CommandsBench do
  alias Aerie.Base.{Names, PubSub, Store}
  alias Aerie.Control.{CommandExecutor, Commands, Ledger, Policy}
  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command
  alias Bench.{Sample, Table}
  alias MavCodec.Messages, as: M

  @gateway :bench
  @key {"main", 7}
  @operator %{name: "ops", role: :operator, permissions: []}
  @widths [34, -12, -12, -12]

  def main(dir, count) do
    section = %{geofence_file: fence(dir), max_altitude: 120, takeoff_battery: 0.3, rates: []}
    {:ok, policy} = Policy.compile(section)
    start(dir, section)
    Table.columns(["#{count} single calls, µs", "median", "p99", "longest"], @widths)
    context = Context.of(@gateway, snapshot(), @operator, System.os_time(:microsecond))

    measure("policy: goto, 100 corners", numbered(count, &command("goto", goto(&1))), fn command ->
      :allow = Policy.decide(policy, command, context)
    end)

    executor(count)
    register(:commands, &answer_at_once/0)
    pipeline("goto", "goto", count, &goto/1)
    pipeline("takeoff (to the disk)", "takeoff", count, fn _n -> %{altitude: 20} end)
    pipeline("rtl", "rtl", count, fn _n -> %{} end)
    steps(count)
  end

  defp fence(dir) do
    corners =
      for n <- 0..99 do
        angle = 2 * :math.pi() * n / 100
        [8.0 + 0.05 * :math.cos(angle), 47.0 + 0.03 * :math.sin(angle)]
      end

    fence = Path.join(dir, "fence.geojson")
    File.write!(fence, JSON.encode!(%{"type" => "Polygon", "coordinates" => [corners ++ [hd(corners)]]}))
    fence
  end

  # A gateway of a store, a policy and a pipeline.
  defp start(dir, section) do
    tables = [
      Commands.Recent.table(),
      Policy.ControlLease.Holders.table(),
      Policy.Memory.ClientHistory.table()
    ]

    policy = Policy.Store.Settings.from(%{policy: Map.put(section, :audit, %{dir: Path.join(dir, "audit")})})
    # More than it keeps of 20 minutes by default.
    ledger = %{dir: Path.join(dir, "ledger"), max_entries: 1_000_000}
    commands = Commands.Settings.from(%{commands: %{ledger: ledger}})

    for {module, options} <- [
          {Store, [tables: tables]},
          {PubSub, []},
          {Policy.Store.Supervisor, [settings: policy, read: nil]},
          {Commands.Supervisor, [settings: commands]}
        ],
        do: {:ok, _} = module.start_link([gateway: @gateway] ++ options)

    Store.put_vehicle(@gateway, @key, snapshot())
  end

  defp snapshot do
    now = System.os_time(:microsecond)

    groups = %{
      mode: %{mode: "GUIDED", armed: true, in_air: true},
      position: %{lat: 47.0, lon: 8.0, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0},
      home: %{lat: 47.0, lon: 8.0, alt_msl: 500.0},
      battery: %{remaining: 0.9}
    }

    %Aerie.Vehicle.Snapshot{
      id: "VID-007",
      key: @key,
      network: "main",
      system_id: 7,
      component: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      status: :online,
      last_heard: now,
      links: [],
      clock: %{rtt_us: 20_000},
      memory: %{sources: %{}, mode_names: %{}, standard_modes: %{}},
      groups: Map.new(groups, fn {name, data} -> {name, %{at: now, data: data}} end)
    }
  end

  defp command(type, params) do
    {:ok, command} = Command.new(vehicle: "VID-007", type: type, params: params, source: "ops")
    command
  end

  defp goto(n), do: %{lat: 47.0 + rem(n, 100) * 1.0e-5, lon: 8.001, altitude: 30}
  defp numbered(count, fun), do: Enum.map(1..count, fun)

  defp measure(name, items, run) do
    times = Sample.calls(items, fn item, _last -> run.(item) end)
    Table.columns([name | for(ns <- Sample.spread(times), do: Float.round(ns / 1000, 1))], @widths)
  end

  # Calls a function again and again in a process that stands for a part of the vehicle.
  defp register(role, fun) do
    caller = self()

    pid =
      spawn_link(fn ->
        :ok = Names.register(@gateway, role, @key)
        send(caller, {self(), :registered})
        Enum.each(Stream.cycle([:again]), fn _again -> fun.() end)
      end)

    receive do: ({^pid, :registered} -> :ok)
  end

  # The session of a vehicle that acknowledges any of the executor's messages.
  defp acknowledge do
    receive do
      {:transmit, messages} ->
        for %M.CommandLong{command: asked, target_component: component} <- messages do
          bytes = MavCodec.encode(%M.CommandAck{command: asked}, system: 7, component: component)
          {[frame], _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 0)
          send(Names.whereis(@gateway, :commands, @key), {:frames, [frame]})
        end

      _other ->
        :ok
    end
  end

  # An executor that carries out everything at once.
  defp answer_at_once do
    receive do
      {:"$gen_call", from, {:submit, %{id: id}, _progress, _still?}} ->
        GenServer.reply(from, Command.Result.new(id, :completed))
    end
  end

  defp executor(count) do
    register(:session, &acknowledge/0)
    options = %{id: "VID-007", key: @key, own_system: 237, own_component: 191}
    {:ok, executor} = CommandExecutor.start_link(gateway: @gateway, options: options)

    # Between two equal commands of a component there is quiet (C8), so no two of these are equal.
    media =
      for component <- 1..255,
          type <- ["camera_photo", "camera_video"],
          action <- ["start", "stop"],
          do: command(type, %{action: action, component: component})

    measure("executor: to the vehicle and back", Enum.take(media, count), fn command ->
      %{status: :accepted} = CommandExecutor.submit(@gateway, @key, command)
    end)

    GenServer.stop(executor)
  end

  defp pipeline(name, type, count, params) do
    requests =
      numbered(
        count,
        &[vehicle: "VID-007", type: type, id: "#{type}-#{&1}", params: params.(&1), as: @operator]
      )

    measure("pipeline: #{name}", requests, fn request ->
      Store.put_vehicle(@gateway, @key, snapshot())
      {:ok, %{status: :completed}} = Commands.submit(@gateway, request)
    end)
  end

  defp steps(count) do
    own = fn name -> numbered(count, &%{command("goto", goto(&1)) | id: "#{name}-#{&1}"}) end
    [steps, disk] = Enum.map(["step", "disk"], own)
    entry = %{"type" => "decision", "decision" => "allow", "vehicle" => "VID-007", "command" => "goto"}

    for {name, items, run} <- [
          {"ledger: known", steps, &(:new = Ledger.known(@gateway, &1))},
          {"ledger: admit", steps, &(:new = Ledger.admit(@gateway, &1))},
          {"ledger: sending", steps, &(:ok = Ledger.sending(@gateway, &1.id, :safe))},
          {"ledger: finish", steps, &(:ok = Ledger.finish(@gateway, Command.Result.new(&1.id, :completed)))},
          {"ledger: admit", disk, &(:new = Ledger.admit(@gateway, &1))},
          {"ledger: sending (to the disk)", disk, &(:ok = Ledger.sending(@gateway, &1.id, :never))},
          {"audit log: append", numbered(count, fn _n -> entry end), &({:ok, _} = Audit.append(@gateway, &1))}
        ],
        do: measure("  " <> name, items, run)
  end
end

defmodule CommandsBench.Stations do
  @moduledoc """
  Ground stations that ask for all parameters of a simulated ArduPilot, at once or each after the one before has them,
  through a gateway that knows none of them yet: what the vehicle had to send for it (PARAM_VALUE and MAVLink FTP,
  counted on its wire), and how long it took until the last station had them all. All that ask at once hear one list
  even without `served`, because the vehicle sends it to everybody.
  """

  alias Aerie.Base.{Names, PubSub, Store}
  alias Aerie.Control.{Params, Policy, ReadCache}
  alias Bench.{Gateway, Sample, Table}
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser
  alias MavRouter.{Link, Router}

  @parts [
           Store,
           PubSub,
           Policy.Store.Supervisor,
           Router.Supervisor,
           Aerie.Vehicle.Supervisor,
           Link.Supervisor
         ] ++
           [Params.Cache.Writer, ReadCache.Supervisor]
  @counted [M.ParamValue.id(), M.FileTransferProtocol.id()]
  # What ground stations wait until they ask for what is missing.
  @silence_ms 1_000
  @widths [-8, -13, -9, -24, -32]
  @socket [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 4_000_000]

  def main(dir) do
    IO.puts("")

    Table.columns(
      ["stations", "they ask", "served", "frames of the vehicle", "ms until the last one has all"],
      @widths
    )

    for order <- [:at_once, :in_turn], served? <- [true, false], n <- [1, 5, 20] do
      {frames, ms} = run(Path.join(dir, "stations-#{n}-#{order}-#{served?}"), n, order, served?)
      ask = String.replace("#{order}", "_", " ")
      Table.columns([n, ask, if(served?, do: "on", else: "off"), frames, ms], @widths)
    end
  end

  defp run(dir, n, order, served?) do
    gateway = make_ref()
    parts = Gateway.parts(gateway, Gateway.config(dir), @parts)
    {wire, wire_port} = wire(Gateway.link(gateway, "udpin:127.0.0.1:0", network: "main"))
    sim = Gateway.sim(wire_port, ready_s: 0.5)
    known? = &match?(%{capabilities: bits, clock: %{rtt_us: us}} when is_integer(bits) and is_integer(us), &1)
    Sample.until(fn -> known?.(Store.vehicle(gateway, {"main", 1})) end)
    to = Gateway.client(gateway, %{url: "udpin:127.0.0.1:0", id: "gcs", served: served?})
    Sample.until(fn -> Names.whereis(gateway, :read_cache, {"main", 1}) end)
    before = count(wire)
    options = [max_concurrency: if(order == :at_once, do: n, else: 1), timeout: :infinity]
    ms = Sample.ms(fn -> 1..n |> Task.async_stream(&station(to, 200 + &1), options) |> Stream.run() end)
    frames = count(wire) - before
    GenServer.stop(sim)
    Process.exit(wire, :normal)

    for pid <- Enum.reverse(parts) do
      Process.unlink(pid)
      GenServer.stop(pid, :shutdown)
    end

    {frames, round(ms)}
  end

  # Between the vehicle and the gateway: counts what the vehicle sends.
  defp wire(port) do
    caller = self()

    pid =
      spawn_link(fn ->
        [{:ok, vehicle}, {:ok, gateway}] = for _side <- 1..2, do: :gen_udp.open(0, @socket)
        :ok = :gen_udp.connect(gateway, {127, 0, 0, 1}, port)
        {:ok, at} = :inet.port(vehicle)
        send(caller, {self(), at})
        pass(vehicle, gateway, nil, Parser.new(), 0)
      end)

    receive do: ({^pid, at} -> {pid, at})
  end

  defp pass(vehicle, gateway, peer, parser, n) do
    receive do
      {:udp, ^vehicle, ip, port, bytes} ->
        :gen_udp.send(gateway, bytes)
        {frames, parser} = Parser.push_datagram(parser, bytes, nil)
        pass(vehicle, gateway, {ip, port}, parser, n + Enum.count(frames, &(&1.id in @counted)))

      {:udp, ^gateway, _ip, _port, bytes} ->
        :gen_udp.send(vehicle, elem(peer, 0), elem(peer, 1), bytes)
        pass(vehicle, gateway, peer, parser, n)

      {:count, from} ->
        send(from, {self(), n})
        pass(vehicle, gateway, peer, parser, n)

      _other ->
        pass(vehicle, gateway, peer, parser, n)
    end
  end

  defp count(wire) do
    send(wire, {:count, self()})
    receive do: ({^wire, n} -> n)
  end

  defp station(port, system) do
    {:ok, socket} = :gen_udp.open(0, @socket)
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    say = &(:ok = :gen_udp.send(socket, MavCodec.encode(&1, system: system, component: 190)))
    say.(%M.Heartbeat{type: 6, autopilot: 8})
    say.(%M.ParamRequestList{target_system: 1, target_component: 1})
    hear(socket, say, Parser.new(), MapSet.new(), nil)
  end

  defp hear(socket, say, parser, known, total) do
    if total != nil and MapSet.size(known) == total do
      :gen_udp.close(socket)
    else
      receive do
        {:udp, ^socket, _ip, _port, bytes} ->
          {frames, parser} = Parser.push_datagram(parser, bytes, nil)
          messages = for %{id: 22} = frame <- frames, {:ok, m} <- [MavCodec.decode(frame)], do: m
          values = Enum.filter(messages, &(&1.param_index < 65_535))
          known = Enum.reduce(values, known, &MapSet.put(&2, &1.param_index))
          hear(socket, say, parser, known, if(values == [], do: total, else: hd(values).param_count))
      after
        @silence_ms ->
          ask(say, known, total)
          hear(socket, say, parser, known, total)
      end
    end
  end

  defp ask(say, _known, nil), do: say.(%M.ParamRequestList{target_system: 1, target_component: 1})

  defp ask(say, known, total) do
    for index <- 0..(total - 1) |> Enum.reject(&(&1 in known)) |> Enum.take(10),
        do: say.(%M.ParamRequestRead{target_system: 1, target_component: 1, param_index: index, param_id: ""})
  end
end

options = Bench.Options.read(__ENV__.file, commands: 5_000, dir: System.tmp_dir!())
dir = Path.join(options[:dir], "aerie-bench-commands-#{System.pid()}")
File.mkdir_p!(dir)
CommandsBench.main(dir, options[:commands])
CommandsBench.Stations.main(dir)
Bench.Table.machine()
File.rm_rf!(dir)
