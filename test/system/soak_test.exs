defmodule Aerie.System.SoakTest do
  @moduledoc """
  Runs a gateway for a long time: fifty simulated vehicles fly, some of them behind bad radios, recorded flights of real firmware
  are replayed, and links, clients, cables and vehicles come and go, in rounds. A census of the node follows each round. Once all
  bounded buffers have filled, nothing may grow.

  `AERIE_SOAK_MINUTES` sets the duration (default 60); `AERIE_SOAK_PRINT=1` prints every round.
  """

  # The census covers the whole node, so no other test may run meanwhile.
  use Aerie.SystemCase, async: false

  alias Aerie.{Census, SerialPeer}
  alias Aerie.Base.Names
  alias MavRouter.{Client, Link}
  alias Aerie.Vehicle.Services.Streams

  @moduletag :soak
  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag timeout: :infinity

  @vehicles 50
  # Rings and journals fill to their bounds first; nothing is compared during this time.
  @warm_up 0.4
  # Rows of what is bounded by design and varies with the machine's load: claims of peers that are gone, what was read within two minutes,
  # values that wait for NATS (one for each group of a vehicle).
  @bounds %{claims: 4_096, ring: @vehicles * 120 * 25, bridge_values: @vehicles * 20}
  @max_waiting 1_000
  @fixtures Path.expand("../../apps/vehicle/test/fixtures", __DIR__)

  test "nothing grows while links, clients and vehicles come and go", %{tmp_dir: folder} do
    Census.load([
      :vehicle,
      :mav_codec,
      :sim_vehicle,
      :access,
      :api,
      :console,
      :circuits_uart,
      :gnat,
      :telemetry,
      :aerie
    ])

    Census.load([:cowboy, :cowlib, :ranch, :crypto, :ssl, :public_key, :inets, :ex_unit, :kernel, :stdlib])
    dev = short_dir()
    sockets = short_dir()
    cable? = SerialPeer.build()

    %{gateway: gateway} =
      start_gateway(folder,
        links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"],
        overrides: %{
          "mavlink" => %{"local_addr" => "off"},
          "sockets" => %{"dir" => sockets},
          "recorder" => %{
            "dir" => Path.join(folder, "recordings"),
            "links" => "always",
            "vehicles" => "always",
            "max_file_mb" => 4,
            # Batteries get low within the hour, and each such event saves a ring, which is a process and a file for as long.
            "after_s" => 5,
            "max_mb" => 20
          }
        }
      )

    ports = {link_port(gateway, "link-1"), link_port(gateway, "link-2")}

    fleet =
      start_supervised!(
        {SimVehicle.Fleet,
         count: @vehicles, link: fn n -> "udpout:127.0.0.1:#{elem(ports, rem(n, 2))}" end, ready_s: 1.0}
      )

    eventually(fn -> length(Store.vehicles(gateway)) == @vehicles end, "all vehicles are known")
    plug = if cable?, do: SerialPeer.start(cable(dev))

    if cable?,
      do:
        {:ok, "cable"} =
          Link.start(gateway, "serial:auto?only=true&ports=#{dev}/ttyACM0", id: "cable", network: "cable")

    soak = %{
      gateway: gateway,
      fleet: fleet,
      sockets: sockets,
      plug: plug,
      dev: dev,
      endpoints: length(Client.endpoints(gateway)),
      recordings: recordings(folder),
      warm: System.monotonic_time(:second) + round(minutes() * 60 * @warm_up),
      until: System.monotonic_time(:second) + minutes() * 60
    }

    {first, last, compared} = rounds(soak, 1, nil)
    assert compared > 1, "too short for a comparison"
    compare(first, last, compared)

    for n <- 1..@vehicles do
      vehicle = eventually(fn -> Store.vehicle(gateway, {"main", n}) end, "vehicle #{n} is known")
      assert vehicle.status == :online
    end
  end

  defp minutes, do: System.get_env("AERIE_SOAK_MINUTES", "60") |> String.to_integer()
  defp print(words), do: if(System.get_env("AERIE_SOAK_PRINT") == "1", do: IO.puts(:stderr, words))

  # Returns the census after the warm-up, the last one, and the number of rounds between them.
  defp rounds(soak, n, first) do
    round(soak, n)
    census = settled(soak, first && elem(first, 0))
    print("round #{n}: #{Census.format(census)}")
    now = System.monotonic_time(:second)

    case first do
      nil -> rounds(soak, n + 1, if(now >= soak.warm, do: {census, n}))
      {begun, at} when now >= soak.until and n > at -> {begun, census, n - at}
      first -> rounds(soak, n + 1, first)
    end
  end

  # What has ended takes a moment to disappear: counts until there is no more than before, for half a minute at most.
  defp settled(soak, first, deadline \\ System.monotonic_time(:millisecond) + 30_000) do
    census = without_recent(Census.take(), soak)

    same? =
      first == nil or
        Enum.all?([:processes, :ports, :files, :programs], &(Map.fetch!(census, &1) <= Map.fetch!(first, &1)))

    calm? = census.waiting < @max_waiting and (first == nil or grown(first, census) == [])

    if (same? and calm? and quiet?(soak)) or
         System.monotonic_time(:millisecond) > deadline do
      census
    else
      Process.sleep(500)
      settled(soak, first, deadline)
    end
  end

  # The journal keeps the last 256 events of each vehicle, and an hour does not fill that.
  defp without_recent(census, %{gateway: gateway}) do
    recent = :ets.select_count(Store.table!(gateway, :journal), [{{{:recent, :_, :_}, :_}, [], [true]}])
    %{census | tables: Map.update!(census.tables, :journal, &(&1 - recent))}
  end

  defp quiet?(%{gateway: gateway, plug: plug} = soak) do
    (plug == nil or match?(%{status: :up}, Store.link(gateway, "cable"))) and
      length(Client.endpoints(gateway)) <= soak.endpoints
  end

  defp compare(first, last, rounds) do
    # Code that runs for the first time may add an atom; atoms that come with each round are a leak.
    assert last.atoms - first.atoms < max(rounds / 2, 3),
           "atoms: #{first.atoms} at first, #{last.atoms} at the end"

    for what <- [:processes, :ports, :files, :programs] do
      assert Map.fetch!(last, what) <= Map.fetch!(first, what),
             "#{what}: #{Map.fetch!(first, what)} at first, #{Map.fetch!(last, what)} at the end; more or fewer: #{inspect(Census.changed(first, last), limit: :infinity)}"
    end

    # The vehicles are in flight, so what they hold varies a little.
    for what <- [:memory, :ets] do
      {before, now} = {Map.fetch!(first, what), Map.fetch!(last, what)}
      assert now < before * 1.15 + 4_000_000, "#{what}: #{before} bytes at first, #{now} at the end"
    end

    assert grown(first, last) == [], "tables that grew: #{inspect(grown(first, last))}"
    assert last.waiting < @max_waiting
  end

  defp grown(first, last) do
    for {name, rows} <- last.tables,
        before = Map.get(first.tables, name, 0),
        rows > max(before * 1.25 + 64, Map.get(@bounds, name, 0)),
        do: {name, before, rows}
  end

  ## One round: each thing comes and goes once or more

  defp round(soak, n) do
    tasks =
      for churn <- [&replays/2, &links/2, &clients/2, &endpoints/2, &cables/2, &vehicles/2, &radios/2] do
        Task.async(fn -> churn.(soak, n) end)
      end

    Task.await_many(tasks, 180_000)
  end

  # Two replays at a time, sped up, each in its own network; removed before or after their end.
  defp replays(%{gateway: gateway, recordings: recordings}, n) do
    for {file, k} <- Enum.with_index(recordings), rem(k, 2) == rem(n, 2) do
      {:ok, id} =
        Link.start(gateway, "replay:#{file}?speed=#{if rem(n, 3) == 0, do: "max", else: 20}",
          id: "replay-#{k}",
          network: "replay-#{k}"
        )

      id
    end
    |> tap(fn _ids -> Process.sleep(5_000) end)
    |> Enum.each(&Link.stop(gateway, &1))
  end

  # A link without a caller, one that calls a dead address, one whose peer hangs up again and again.
  defp links(%{gateway: gateway}, n) do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)
    {:ok, tcp} = Link.start(gateway, "tcp:127.0.0.1:#{port}", id: "tcp-#{n}", network: "churn")

    {:ok, calls} =
      Link.start(gateway, "udpout:127.0.0.1:#{free_udp_port()}", id: "calls-#{n}", network: "churn")

    {:ok, waits} = Link.start(gateway, "udpin:127.0.0.1:0", id: "waits-#{n}", network: "churn")
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}])

    for k <- 1..5 do
      with {:ok, connection} <- :gen_tcp.accept(listener, 2_000) do
        :gen_tcp.send(connection, heartbeat(200) <> :crypto.strong_rand_bytes(500))
        :gen_tcp.close(connection)
      end

      :gen_udp.send(socket, {127, 0, 0, 1}, link_port(gateway, waits), heartbeat(200 + k) <> <<0xFD, 1, 2>>)
    end

    :gen_udp.close(socket)
    Process.exit(Names.whereis(gateway, :link, calls), :kill)
    Enum.each([tcp, calls, waits], &Link.stop(gateway, &1))
    :gen_tcp.close(listener)
    for k <- 0..5, do: Aerie.Vehicle.Supervisor.remove(gateway, {"churn", 200 + k})
  end

  # Ground stations at the sockets: one that reads, one that does not, one that leaves in mid-frame; and rate requests.
  defp clients(%{gateway: gateway, sockets: sockets}, n) do
    for k <- 1..10 do
      {:ok, gcs} = :gen_tcp.connect({:local, Path.join(sockets, "mavlink.sock")}, 0, [:binary, active: false])
      {:ok, state} = :gen_tcp.connect({:local, Path.join(sockets, "state.sock")}, 0, [:binary, active: false])
      bytes = heartbeat(250, 6)
      :gen_tcp.send(gcs, <<byte_size(bytes)::32-little, bytes::binary>>)
      if rem(k, 2) == 0, do: :gen_tcp.recv(gcs, 2_000, 5_000)
      if rem(k, 3) == 0, do: :gen_tcp.recv(state, 0, 5_000)

      wanter =
        spawn(fn -> Streams.want(gateway, {"main", rem(k, @vehicles) + 1}, self(), 30, 5 + rem(n, 5)) end)

      reference = Process.monitor(wanter)
      assert_receive {:DOWN, ^reference, :process, ^wanter, _}
      :gen_tcp.send(gcs, <<500::32-little, "cut">>)
      :gen_tcp.close(gcs)
      :gen_tcp.close(state)
    end

    {:ok, {{_, 200, _}, _, _}} =
      :httpc.request(~c"http://127.0.0.1:#{Aerie.Api.Endpoint.port(gateway)}/metrics")
  end

  # Client endpoints that are added and removed, with a client that talks to them.
  defp endpoints(%{gateway: gateway}, _n) do
    {:ok, udp} = Client.add(gateway, "udpin:127.0.0.1:0")
    {:ok, tcp} = Client.add(gateway, "tcpin:127.0.0.1:0")
    at = Map.new(Client.endpoints(gateway), &{&1.id, &1.port})

    for k <- 1..20 do
      {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
      :gen_udp.send(socket, {127, 0, 0, 1}, at[udp], heartbeat(230 + k, 6))
      :gen_udp.recv(socket, 0, 2_000)
      :gen_udp.close(socket)
      {:ok, connection} = :gen_tcp.connect({127, 0, 0, 1}, at[tcp], [:binary, active: false])
      :gen_tcp.send(connection, heartbeat(230 + k, 6))
      :gen_tcp.recv(connection, 1_000, 2_000)
      :gen_tcp.close(connection)
    end

    Client.remove(gateway, udp)
    Client.remove(gateway, tcp)
  end

  defp cables(%{plug: nil}, _n), do: :ok

  defp cables(%{gateway: gateway, plug: plug, dev: dev}, _n) do
    for _ <- 1..3 do
      eventually(
        fn -> match?(%{status: :up}, Store.link(gateway, "cable")) end,
        "the cable's vehicle is found"
      )

      SerialPeer.unplug(plug)

      eventually(
        fn -> match?(%{status: status} when status != :up, Store.link(gateway, "cable")) end,
        "the cable is missed"
      )

      SerialPeer.plug_in(plug, name_in: {dev, "ttyACM0"})
    end
  end

  # One vehicle is restarted, one's processes are killed, one has another id for a while.
  defp vehicles(%{gateway: gateway, fleet: fleet}, n) do
    sims = SimVehicle.Fleet.sims(fleet)
    :ok = SimVehicle.reboot(sims[rem(n, @vehicles) + 1])
    victim = {"main", rem(n + 3, @vehicles) + 1}

    for role <- [:session, :events, :tree] do
      if pid = Names.whereis(gateway, role, victim), do: Process.exit(pid, :kill)
    end

    eventually(fn -> Names.whereis(gateway, :session, victim) end, "its session is back")
  end

  # A tenth of the vehicles have a bad radio, others in each round; one is not heard for so long that it counts as lost.
  defp radios(%{gateway: gateway, fleet: fleet}, n) do
    sims = SimVehicle.Fleet.sims(fleet)
    bad = for k <- 0..(div(@vehicles, 10) - 1), sim = sims[rem(n * 7 + k * 10, @vehicles) + 1], do: sim
    faults = [loss: 0.2, duplicate: 0.1, reorder: 0.1, corrupt: 0.02, delay: {50, 100}]

    for sim <- bad,
        {fault, value} <- faults,
        direction <- [:in, :out],
        do: :ok = SimVehicle.fault(sim, fault, value, direction)

    silent = rem(n * 3, @vehicles) + 1
    :ok = SimVehicle.fault(sims[silent], :silence, true)
    status = fn -> Store.vehicle(gateway, {"main", silent}).status end
    eventually(fn -> status.() == :lost end, "vehicle #{silent} is missed")
    :ok = SimVehicle.fault(sims[silent], :silence, false)
    eventually(fn -> status.() == :online end, "vehicle #{silent} is back")

    for sim <- bad,
        {fault, _value} <- faults,
        direction <- [:in, :out],
        do: :ok = SimVehicle.fault(sim, fault, if(fault == :delay, do: 0, else: 0.0), direction)
  end

  defp cable(dev) do
    says = fn turn -> heartbeat(1, 2, 3) <> attitude(turn) end
    [baud: :any, every: 50, says: says, name_in: {dev, "ttyACM0"}]
  end

  defp heartbeat(system, type \\ 2, autopilot \\ nil) do
    autopilot = autopilot || if(type == 6, do: 8, else: 3)

    message = %MavCodec.Messages.Heartbeat{
      type: type,
      autopilot: autopilot,
      system_status: 4,
      mavlink_version: 3
    }

    MavCodec.encode(message, system: rem(system, 256), component: if(type == 6, do: 190, else: 1))
  end

  defp attitude(turn) do
    MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: turn * 50},
      system: 1,
      component: 1,
      seq: rem(turn, 256)
    )
  end

  defp recordings(folder) do
    for file <- Path.wildcard(Path.join(@fixtures, "*.tlog.gz")) do
      plain = Path.join(folder, Path.basename(file, ".gz"))
      File.write!(plain, file |> File.read!() |> :zlib.gunzip())
      plain
    end
  end
end
