# What a whole gateway (its NATS server included) costs with so many vehicles, each saying 50 frames a second from a socket of its own;
# then what a hub costs that gets the state of many remote vehicles over NATS, once a second.
#
#     bin/bench fleet [--vehicles 10,50,200,500] [--rate 50] [--seconds 20] [--remote 1000] [--out FILE]
#
# The gateway is one OS process with its nats-server beside it, the load a C program (bench/support/hub_load.c), and this program the
# NATS client that looks on; all on the same cores. Columns of vehicles: frames other than heartbeats that were sent, lost, and of the lost
# those that were counted; CPU of the gateway and of nats-server in per cent of one core; memory of the VM per vehicle without code, above that of
# the same gateway without vehicles, and besides of the recorder's ring, which is bounded by time and bytes; from before a frame's `send` (its clock, in whole ms) until its vehicle's state shows it in the store, and from
# before a heartbeat's until a NATS client has the mode that it brought, of ten vehicles; state messages that were replaced by newer ones before they were sent.
#
# Columns of remote vehicles: state messages that were published, taken, dropped; CPU of the hub; memory per vehicle; how old a value is when the
# hub shows it. FILE gets the rows as JSON, for bench/support/plot_fleet.py.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/os_process.ex", __DIR__)

defmodule FleetBench do
  alias Aerie.Bench.OSProcess

  # Systems of one network: an id is a byte, and a few are taken.
  @of_network 240
  # As in bench/support/fleet_node.exs.
  @watched 10

  def main(argv) do
    options =
      MavCodec.Bench.Options.read(__ENV__.file, argv,
        vehicles: "10,50,200,500",
        rate: 50,
        seconds: 20,
        remote: 1_000,
        out: ""
      )

    dir = Path.join(System.tmp_dir!(), "fleet-bench-#{System.pid()}")
    File.mkdir_p!(dir)

    try do
      load = OSProcess.compile(Path.join(__DIR__, "support/hub_load.c"), Path.join(dir, "hub_load"))
      context = %{dir: dir, load: load, rate: options[:rate], seconds: options[:seconds]}

      head(
        [
          "vehicles",
          "sent",
          "lost",
          "counted",
          "CPU gateway",
          "CPU NATS",
          "kB/vehicle + ring",
          "store p50/p99/max ms"
        ] ++
          ["NATS p50/p99/max ms", "superseded"]
      )

      local = for n <- numbers(options[:vehicles]), do: vehicles(context, n)
      IO.puts("")

      head([
        "remote",
        "published",
        "taken",
        "dropped",
        "CPU hub",
        "CPU NATS",
        "kB/vehicle",
        "shown p50/p99/max ms"
      ])

      remote = if options[:remote] > 0, do: [remote(context, options[:remote])], else: []
      IO.puts("\n#{System.schedulers_online()} cores, load #{OSProcess.load()} at the end")

      if options[:out] != "",
        do:
          File.write!(options[:out], JSON.encode!(%{vehicles: local, remote: remote, load: OSProcess.load()}))
    after
      File.rm_rf!(dir)
    end
  end

  defp numbers(text), do: for(word <- String.split(text, ",", trim: true), do: String.to_integer(word))

  ## Vehicles on links

  defp vehicles(context, vehicles) do
    links = ceil(vehicles / @of_network)
    port = OSProcess.base_port(vehicles)

    with_node(context, [port, links, 0], fn node, conn ->
      none = report(node)
      before = until_known(context, node, port, vehicles, links, 20)
      looker = look(conn, before["watched"])
      cpu = OSProcess.cpus(node)
      sent = load(context, port, vehicles, links, context.seconds)
      cpu = shares(cpu, OSProcess.cpus(node), context.seconds)
      ages = ages(looker)
      after_ = report(node)

      row = %{
        vehicles: vehicles,
        sent: sent,
        lost: sent - after_["received"],
        counted: after_["dropped"],
        cpu: cpu.gateway,
        cpu_nats: cpu.nats,
        kb: each(vehicles, none, after_, "memory") - each(vehicles, none, after_, "ring"),
        kb_ring: each(vehicles, none, after_, "ring"),
        store: after_["store"],
        nats: ages,
        superseded: after_["superseded"],
        heard: after_["heard"]
      }

      print(
        [
          vehicles,
          sent,
          row.lost,
          row.counted,
          "#{row.cpu} %",
          "#{row.cpu_nats} %",
          "#{row.kb} + #{row.kb_ring}"
        ] ++
          [three(row.store), three(row.nats), row.superseded]
      )

      row
    end)
  end

  # Frames that waited for their vehicle's start are old, and would be counted as late.
  defp until_known(context, node, port, vehicles, links, rounds) do
    load(context, port, vehicles, links, 5)
    %{"heard" => heard} = report = report(node)

    cond do
      heard == vehicles ->
        report

      rounds > 1 ->
        until_known(context, node, port, vehicles, links, rounds - 1)

      true ->
        raise "only #{heard} of #{vehicles} vehicles are known after 20 rounds of 5 s; ask for fewer"
    end
  end

  defp each(vehicles, none, after_, what), do: round((after_[what] - none[what]) / vehicles / 1000)

  defp load(context, port, vehicles, links, seconds) do
    args = Enum.map([port, vehicles, links, context.rate, seconds, 0, @watched], &to_string/1)
    {text, 0} = System.cmd(context.load, args)
    JSON.decode!(text)["sent"]
  end

  # A client that has the modes of some vehicles, and how old the heartbeat was when its mode came.
  defp look(conn, ids) do
    test = self()

    pid =
      spawn_link(fn ->
        for id <- ids, do: {:ok, _sid} = Gnat.sub(conn, self(), "fleet.*.#{id}.state.mode")

        send(test, {self(), :looking})
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
    receive do: ({:ages, ages} -> spread(Enum.sort(ages)))
  end

  ## Remote vehicles

  defp remote(context, vehicles) do
    with_node(context, [OSProcess.base_port(1), 1, 1], fn node, conn ->
      bodies = for n <- 1..vehicles, do: {"FAR-#{String.pad_leading("#{n}", 4, "0")}", n}
      none = report(node)
      publish(conn, bodies, 3)
      report(node)
      cpu = OSProcess.cpus(node)
      published = publish(conn, bodies, context.seconds)
      cpu = shares(cpu, OSProcess.cpus(node), context.seconds)
      after_ = report(node)

      row = %{
        vehicles: vehicles,
        published: published,
        taken: after_["remote"],
        dropped: after_["remote_dropped"],
        cpu: cpu.gateway,
        cpu_nats: cpu.nats,
        kb: each(vehicles, none, after_, "memory"),
        shown: after_["shown"]
      }

      print([
        vehicles,
        published,
        row.taken,
        row.dropped,
        "#{row.cpu} %",
        "#{row.cpu_nats} %",
        row.kb,
        three(row.shown)
      ])

      row
    end)
  end

  # Each vehicle's groups once a second, spread over the second.
  defp publish(conn, vehicles, seconds) do
    started = System.monotonic_time(:microsecond)
    slices = Enum.chunk_every(vehicles, max(div(length(vehicles), 50), 1))

    for second <- 0..(seconds - 1), {slice, n} <- Enum.with_index(slices), reduce: 0 do
      sent ->
        due = started + second * 1_000_000 + div(n * 1_000_000, length(slices))
        wait_ms = div(due - System.monotonic_time(:microsecond), 1000)
        if wait_ms > 0, do: Process.sleep(wait_ms)
        sent + Enum.sum(for {id, n} <- slice, do: state(conn, id, n))
    end
  end

  defp state(conn, id, n) do
    now = System.os_time(:microsecond)

    groups = %{
      "position" => %{lat: 47.0 + n / 10_000, lon: 8.0, alt_msl: 500.0, alt_rel: 50.0, heading: 12.0},
      "velocity" => %{vn: 1.0, ve: 1.0, vd: 0.0, groundspeed: 1.4, airspeed: 1.4, climb: 0.0, throttle: 0.3},
      "attitude" => %{roll: 1.0, pitch: 2.0, yaw: 3.0, rollspeed: 0.1, pitchspeed: 0.1, yawspeed: 0.1},
      "battery" => %{
        id: 0,
        voltage: 15.9,
        current: 10.0,
        remaining: 0.7,
        consumed_mah: 800,
        charge_state: "OK"
      },
      "mode" => %{
        mode: "AUTO",
        custom_mode: 3,
        armed: true,
        in_air: true,
        failsafe: false,
        system_status: "ACTIVE"
      },
      "gateway" => %{
        network: "main",
        system_id: 1,
        autopilot: "px4",
        type: "copter",
        status: "online",
        silent_s: 0.1
      }
    }

    for {group, data} <- groups do
      body =
        Aerie.Fleet.Bridge.Message.state(id, group, data, nil, now, %{epoch: 1, gateway: "gateway-#{id}"})

      :ok = Gnat.pub(conn, "fleet.dev.#{id}.state.#{group}", body)
    end

    map_size(groups)
  end

  ## The gateway

  defp with_node(context, arguments, fun) do
    folder = Path.join(context.dir, "node-#{System.unique_integer([:positive])}")
    File.mkdir_p!(folder)
    script = Path.join(__DIR__, "support/fleet_node.exs")
    node = OSProcess.start(["run", "--no-compile", script, folder | Enum.map(arguments, &to_string/1)])

    try do
      "ready " <> url = OSProcess.line(node, "ready")
      %URI{host: host, port: port, userinfo: token} = URI.parse(url)
      {:ok, conn} = Gnat.start_link(%{host: host, port: port, token: token})

      try do
        fun.(node, conn)
      after
        Gnat.stop(conn)
      end
    after
      OSProcess.stop(node)
    end
  end

  defp report(node), do: node |> OSProcess.ask("report", "{") |> JSON.decode!()

  defp shares(before, now, seconds) do
    Map.new(now, fn {name, cpu} -> {name, round((cpu - before[name]) / seconds * 100)} end)
  end

  defp spread([]), do: nil
  defp spread(sorted), do: Enum.map([0.5, 0.99, 1.0], &Enum.at(sorted, max(ceil(length(sorted) * &1) - 1, 0)))

  defp three(nil), do: "–"
  defp three(values), do: Enum.join(values, " / ")

  defp head(cells) do
    print(cells)
    IO.puts("|" <> String.duplicate("---|", length(cells)))
  end

  defp print(cells), do: IO.puts("| " <> Enum.join(cells, " | ") <> " |")
end

FleetBench.main(System.argv())
