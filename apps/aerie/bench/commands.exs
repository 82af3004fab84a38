# What a command costs on its way to a vehicle: the policy, the executor, the pipeline around them (ledger, audit log, rates), and
# each step of the pipeline by itself.
#
#     bin/bench commands [--commands 5000] [--dir FOLDER]
#
# Each line is that many single calls (of the executor at most 1,020), one after the other: median, p99 and the longest, in microseconds. The fence has 100
# corners. `executor` is a command to a vehicle that acknowledges at once: submit to result, with the way to the session and back. `pipeline` is submit to result with an executor that answers at once; takeoff must reach the disk before it is sent,
# because it is never sent twice. Last, 1, 5 and 20 ground stations ask for all parameters of a simulated vehicle at once, with and without `served`:
# what the vehicle had to send. FOLDER is on the disk whose writes count (the system's temporary folder unless given).

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/stations.exs", __DIR__)

alias Aerie.Base.{Names, PubSub, Store}
alias Aerie.Control.{CommandExecutor, Commands, Ledger, Policy}
alias Aerie.Vehicle.Command
alias Aerie.Control.Policy.{Audit, Context}
alias MavCodec.Messages, as: M

options = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), commands: 5_000, dir: System.tmp_dir!())
Logger.configure(level: :error)
count = options[:commands]
dir = Path.join(options[:dir], "aerie-bench-commands-#{System.pid()}")
File.mkdir_p!(dir)
key = {"main", 7}
operator = %{name: "ops", role: :operator, permissions: []}

corners =
  for n <- 0..99 do
    angle = 2 * :math.pi() * n / 100
    [8.0 + 0.05 * :math.cos(angle), 47.0 + 0.03 * :math.sin(angle)]
  end

fence = Path.join(dir, "fence.geojson")
File.write!(fence, JSON.encode!(%{"type" => "Polygon", "coordinates" => [corners ++ [hd(corners)]]}))

snapshot = fn ->
  now = System.os_time(:microsecond)

  %{
    id: "VID-007",
    key: key,
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
    groups: %{
      mode: %{at: now, data: %{mode: "GUIDED", armed: true, in_air: true}},
      position: %{at: now, data: %{lat: 47.0, lon: 8.0, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0}},
      home: %{at: now, data: %{lat: 47.0, lon: 8.0, alt_msl: 500.0}},
      battery: %{at: now, data: %{remaining: 0.9}}
    }
  }
end

command = fn type, params ->
  {:ok, command} = Command.new(vehicle: "VID-007", type: type, params: params, source: "ops")
  command
end

goto = fn n -> %{lat: 47.0 + rem(n, 100) * 1.0e-5, lon: 8.001, altitude: 30} end
section = %{geofence_file: fence, max_altitude: 120, takeoff_battery: 0.3, rates: []}
{:ok, policy} = Policy.compile(section)

# --- A gateway of a store, a policy and a pipeline; one process is the session, another the executor that answers at once

start = fn gateway ->
  tables = [Commands.Recent.table(), Policy.Leases.table(), Policy.ClientHistory.table()]
  {:ok, _} = Store.start_link(gateway: gateway, tables: tables)
  {:ok, _} = PubSub.start_link(gateway: gateway)
  config = %{policy: Map.put(section, :audit, %{dir: Path.join(dir, "audit")})}
  {:ok, _} = Policy.Supervisor.start_link(gateway: gateway, settings: Policy.Settings.from(config), read: nil)
  # More than it keeps of 20 minutes by default.
  ledger = %{ledger: %{dir: Path.join(dir, "ledger"), max_entries: 1_000_000}}
  settings = Commands.Settings.from(%{commands: ledger})
  {:ok, _} = Commands.Supervisor.start_link(gateway: gateway, settings: settings)
  Store.put_vehicle(gateway, key, snapshot.())
  gateway
end

gateway = start.(:bench)

# Any of the executor's messages is acknowledged.
session = fn loop ->
  receive do
    {:transmit, messages} ->
      for %M.CommandLong{command: asked, target_component: component} <- messages do
        bytes = MavCodec.encode(%M.CommandAck{command: asked}, system: 7, component: component)
        {[frame], _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 0)
        send(Names.whereis(gateway, :commands, key), {:frames, [frame]})
      end

      loop.(loop)

    _other ->
      loop.(loop)
  end
end

instant = fn loop ->
  receive do
    {:"$gen_call", from, {:submit, %{id: id}, _progress, _still?}} ->
      GenServer.reply(from, Command.Result.new(id, :completed))
      loop.(loop)
  end
end

register = fn role, fun ->
  caller = self()

  pid =
    spawn_link(fn ->
      :ok = Names.register(gateway, role, key)
      send(caller, :registered)
      fun.(fun)
    end)

  receive do
    :registered -> pid
  end
end

measure = fn name, most, prepare, run ->
  prepared = Enum.map(1..min(count, most), prepare)

  times =
    prepared
    |> Enum.map(fn what ->
      started = System.monotonic_time(:nanosecond)
      run.(what)
      System.monotonic_time(:nanosecond) - started
    end)
    |> Enum.sort()

  at = fn share -> Float.round(Enum.at(times, max(ceil(length(times) * share) - 1, 0)) / 1000, 1) end

  IO.puts(
    String.pad_trailing(name, 34) <>
      Enum.map_join([0.5, 0.99, 1.0], &String.pad_leading("#{at.(&1)}", 12))
  )
end

IO.puts(String.pad_trailing("#{count} single calls, µs", 34) <> "      median         p99     longest")

context = Context.of(gateway, snapshot.(), operator, System.os_time(:microsecond))

measure.("policy: goto, 100 corners", count, fn n -> command.("goto", goto.(n)) end, fn command ->
  :allow = Policy.decide(policy, command, context)
end)

_session = register.(:session, session)

{:ok, executor} =
  CommandExecutor.start_link(
    gateway: gateway,
    options: %{id: "VID-007", key: key, own_system: 237, own_component: 191}
  )

# Between two equal commands of a component there is quiet (C8), so no two of these are equal.
media =
  for component <- 1..255,
      type <- ["camera_photo", "camera_video"],
      action <- ["start", "stop"],
      do: {component, type, action}

measure.(
  "executor: to the vehicle and back",
  length(media),
  fn n ->
    {component, type, action} = Enum.at(media, n - 1)
    command.(type, %{action: action, component: component})
  end,
  fn command -> %{status: :accepted} = CommandExecutor.submit(gateway, key, command) end
)

GenServer.stop(executor)
_executor = register.(:commands, instant)
submit = fn fields -> {:ok, %{status: :completed}} = Commands.submit(gateway, fields) end

pipeline = fn type, params ->
  fn n -> [vehicle: "VID-007", type: type, id: "#{type}-#{n}", params: params.(n), as: operator] end
end

fresh = fn fields ->
  Store.put_vehicle(gateway, key, snapshot.())
  submit.(fields)
end

measure.("pipeline: goto", count, pipeline.("goto", goto), fresh)
measure.("pipeline: takeoff (to the disk)", count, pipeline.("takeoff", fn _n -> %{altitude: 20} end), fresh)
measure.("pipeline: rtl", count, pipeline.("rtl", fn _n -> %{} end), fresh)

own = fn n -> %{command.("goto", goto.(n)) | id: "step-#{n}"} end
measure.("  ledger: known", count, own, &(:new = Ledger.known(gateway, &1)))
measure.("  ledger: admit", count, own, &(:new = Ledger.admit(gateway, &1)))
measure.("  ledger: sending", count, own, &(:ok = Ledger.sending(gateway, &1.id, :safe)))

measure.(
  "  ledger: finish",
  count,
  own,
  &(:ok = Ledger.finish(gateway, Command.Result.new(&1.id, :completed)))
)

measure.(
  "  ledger: admit",
  count,
  fn n -> %{own.(n) | id: "disk-#{n}"} end,
  &(:new = Ledger.admit(gateway, &1))
)

measure.("  ledger: sending (to the disk)", count, fn n -> "disk-#{n}" end, fn id ->
  :ok = Ledger.sending(gateway, id, :never)
end)

entry = %{"type" => "decision", "decision" => "allow", "vehicle" => "VID-007", "command" => "goto"}
measure.("  audit log: append", count, fn _n -> entry end, &({:ok, _} = Audit.append(gateway, &1)))

StationsBench.main(dir)

IO.puts(
  "\n#{System.schedulers_online()} schedulers, load #{File.read!("/proc/loadavg") |> String.split() |> hd()} at the end"
)

File.rm_rf!(dir)
