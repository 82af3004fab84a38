# What a whole gateway (its NATS server included) costs with so many vehicles, each saying 50 frames a second from a
# socket of its own; then what a hub costs that gets the state of many remote vehicles over NATS, once a second.
#
#     bin/bench fleet [--vehicles 10,50,200,500] [--rate 50] [--seconds 20] [--remote 1000] [--out FILE]
#
# The gateway is one OS process with its nats-server beside it, the load a C program (support/vehicle_load.c), and this
# program the NATS client that looks on; all on the same cores. Columns of vehicles: frames other than heartbeats that
# were sent, lost, and of the lost those that were counted; CPU of the gateway and of nats-server in per cent of one
# core; memory of the VM per vehicle without code, above that of the same gateway without vehicles, and besides of the
# recorder's ring, which is bounded by time and bytes; from before a frame's `send` (its clock, in whole ms) until its
# vehicle's state shows it in the store, and from before a heartbeat's until a NATS client has the mode that it
# brought, of ten vehicles; state messages that were replaced by newer ones before they were sent.
#
# Columns of remote vehicles: state messages that were published, taken, dropped; CPU of the hub; memory per vehicle;
# how old a value is when the hub shows it. FILE gets the rows as JSON, for support/plot.py.

Code.require_file("harness.exs", __DIR__)

defmodule FleetBench do
  alias Aerie.Fleet.Bridge.Message
  alias Bench.{OSProcess, Sample, Table, Vehicles}

  # As many as node.exs looks at.
  @watched 10

  def main(dir, options) do
    load = OSProcess.compile("vehicle_load", dir)
    times = ["store p50/p99/max ms", "NATS p50/p99/max ms", "superseded"]

    Table.head([
      "vehicles",
      "sent",
      "lost",
      "counted",
      "CPU gateway",
      "CPU NATS",
      "kB/vehicle + ring" | times
    ])

    local = for n <- Bench.Options.numbers(options[:vehicles]), do: vehicles(dir, load, n, options)
    IO.puts("")

    Table.head([
      "remote",
      "published",
      "taken",
      "dropped",
      "CPU hub",
      "CPU NATS",
      "kB/vehicle",
      "shown p50/p99/max ms"
    ])

    remote = if options[:remote] > 0, do: [remote(dir, options[:remote], options[:seconds])], else: []
    Table.machine()
    rows = %{vehicles: local, remote: remote, load: OSProcess.load()}
    if options[:out] != "", do: File.write!(options[:out], JSON.encode!(rows))
  end

  ## Vehicles on links

  defp vehicles(dir, load, count, options) do
    vehicles = Vehicles.new(load, count, options[:rate], @watched)

    with_node(dir, %{urls: vehicles.urls, remote: false}, fn node, conn ->
      none = OSProcess.report(node)
      before = until_known(node, vehicles, 20)
      looker = look(conn, before["watched"])

      {cpu, sent} =
        OSProcess.shares(node, options[:seconds], fn -> Vehicles.run(vehicles, options[:seconds]) end)

      ages = ages(looker)
      report = OSProcess.report(node)
      ring = each(count, none, report, "ring")

      row = %{
        vehicles: count,
        sent: sent,
        lost: sent - report["received"],
        counted: report["dropped"],
        cpu: cpu.gateway,
        cpu_nats: cpu.nats,
        kb: each(count, none, report, "memory") - ring,
        kb_ring: ring,
        store: report["store"],
        nats: ages,
        superseded: report["superseded"],
        heard: report["heard"]
      }

      kb = "#{row.kb} + #{row.kb_ring}"
      costs = ["#{row.cpu} %", "#{row.cpu_nats} %", kb, row.store, row.nats, row.superseded]
      Table.row([count, sent, row.lost, row.counted | costs])
      row
    end)
  end

  # Frames that waited for their vehicle's start are old, and would be counted as late.
  defp until_known(node, %{count: count} = vehicles, rounds) do
    Vehicles.run(vehicles, 5)
    %{"heard" => heard} = report = OSProcess.report(node)

    cond do
      heard == count -> report
      rounds > 1 -> until_known(node, vehicles, rounds - 1)
      true -> raise "only #{heard} of #{count} vehicles are known after 20 rounds of 5 s; ask for fewer"
    end
  end

  defp each(count, none, report, what), do: round((report[what] - none[what]) / count / 1000)

  # A client that has the modes of some vehicles, and how old the heartbeat was when its mode came.
  defp look(conn, ids) do
    caller = self()

    pid =
      spawn_link(fn ->
        for id <- ids, do: {:ok, _sid} = Gnat.sub(conn, self(), "fleet.*.#{id}.state.mode")
        send(caller, {self(), :looking})
        looking([])
      end)

    receive do: ({^pid, :looking} -> pid)
  end

  defp looking(ages) do
    receive do
      {:msg, %{body: body}} ->
        now = div(:os.perf_counter(:microsecond), 1000)
        %{"data" => %{"custom_mode" => sent}} = JSON.decode!(body)
        looking([now - sent | ages])

      {:ages, whom} ->
        send(whom, {:ages, ages})
    end
  end

  defp ages(looker) do
    send(looker, {:ages, self()})
    receive do: ({:ages, ages} -> Sample.spread(ages))
  end

  ## Remote vehicles

  defp remote(dir, count, seconds) do
    port = OSProcess.base_port(0..10)

    with_node(dir, %{urls: ["udpin:127.0.0.1:#{port}"], remote: true}, fn node, conn ->
      vehicles = for n <- 1..count, do: {"FAR-#{String.pad_leading("#{n}", 4, "0")}", n}
      none = OSProcess.report(node)
      publish(conn, vehicles, 3)
      OSProcess.report(node)
      {cpu, published} = OSProcess.shares(node, seconds, fn -> publish(conn, vehicles, seconds) end)
      report = OSProcess.report(node)

      row = %{
        vehicles: count,
        published: published,
        taken: report["remote"],
        dropped: report["remote_dropped"],
        cpu: cpu.gateway,
        cpu_nats: cpu.nats,
        kb: each(count, none, report, "memory"),
        shown: report["shown"]
      }

      costs = ["#{row.cpu} %", "#{row.cpu_nats} %", row.kb, row.shown]
      Table.row([count, published, row.taken, row.dropped | costs])
      row
    end)
  end

  # Each vehicle's groups once a second, spread over the second.
  defp publish(conn, vehicles, seconds) do
    started = System.monotonic_time(:microsecond)
    slices = Enum.chunk_every(vehicles, max(div(length(vehicles), 50), 1))

    for second <- 0..(seconds - 1), {slice, n} <- Enum.with_index(slices), reduce: 0 do
      sent ->
        Sample.sleep_until(started + second * 1_000_000 + div(n * 1_000_000, length(slices)))
        sent + Enum.sum_by(slice, fn {id, n} -> state(conn, id, n) end)
    end
  end

  defp state(conn, id, n) do
    now = System.os_time(:microsecond)
    gateway = %{epoch: 1, gateway: "gateway-#{id}"}

    for {group, data} <- groups(n) do
      body = Message.state(id, group, data, nil, now, gateway)
      :ok = Gnat.pub(conn, "fleet.dev.#{id}.state.#{group}", body)
    end
    |> length()
  end

  defp groups(n) do
    [
      {"position", %{lat: 47.0 + n / 10_000, lon: 8.0, alt_msl: 500.0, alt_rel: 50.0, heading: 12.0}},
      {"velocity", %{vn: 1.0, ve: 1.0, vd: 0.0, groundspeed: 1.4, airspeed: 1.4, climb: 0.0, throttle: 0.3}},
      {"attitude", %{roll: 1.0, pitch: 2.0, yaw: 3.0, rollspeed: 0.1, pitchspeed: 0.1, yawspeed: 0.1}},
      {"battery",
       %{id: 0, voltage: 15.9, current: 10.0, remaining: 0.7, consumed_mah: 800, charge_state: "OK"}},
      {"mode",
       %{mode: "AUTO", custom_mode: 3, armed: true, in_air: true, failsafe: false, system_status: "ACTIVE"}},
      {"gateway",
       %{network: "main", system_id: 1, autopilot: "px4", type: "copter", status: "online", silent_s: 0.1}}
    ]
  end

  ## The gateway

  defp with_node(dir, options, fun) do
    folder = Path.join(dir, "node-#{System.unique_integer([:positive])}")
    File.mkdir_p!(folder)

    OSProcess.with_node(Map.put(options, :folder, folder), fn node, "ready " <> url ->
      %URI{host: host, port: port, userinfo: token} = URI.parse(url)
      {:ok, conn} = Gnat.start_link(%{host: host, port: port, token: token})
      result = fun.(node, conn)
      Gnat.stop(conn)
      result
    end)
  end
end

options =
  Bench.Options.read(__ENV__.file, vehicles: "10,50,200,500", rate: 50, seconds: 20, remote: 1_000, out: "")

Bench.Gateway.in_folder("fleet", &FleetBench.main(&1, options))
