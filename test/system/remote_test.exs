defmodule Aerie.System.RemoteTest do
  @moduledoc """
  A hub and a companion with real nats-servers: the hub shows and commands a vehicle that only the companion hears.
  """
  use Aerie.SystemCase, async: true

  alias Aerie.{CommandCase, Fleet, HubServer}
  alias Aerie.Control.{Commands, Files, Missions, Params}
  alias Aerie.Fleet.Bridge
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Event

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-001"
  @companion "gateway-VID-001"
  @plan JSON.encode!(%{
          "fileType" => "Plan",
          "version" => 1,
          "groundStation" => "QGroundControl",
          "geoFence" => %{"version" => 2, "polygons" => [], "circles" => []},
          "rallyPoints" => %{"version" => 2, "points" => []},
          "mission" => %{
            "version" => 2,
            "firmwareType" => 3,
            "vehicleType" => 2,
            "cruiseSpeed" => 15,
            "hoverSpeed" => 5,
            "plannedHomePosition" => [47.3977, 8.5456, 488.0],
            "items" =>
              for {command, seq} <- [{22, 1}, {16, 2}] do
                %{
                  "type" => "SimpleItem",
                  "command" => command,
                  "doJumpId" => seq,
                  "frame" => 3,
                  "autoContinue" => true,
                  "params" => [0, 0, 0, nil, 47.3977, 8.5456, 20]
                }
              end
          }
        })

  setup %{tmp_dir: folder} = context do
    nkey = Nkey.generate(:user)
    seed = private_file(folder, "hub.nk", Nkey.seed(nkey))

    server =
      if context[:leaf],
        do: HubServer.start(folder, [@vehicle], Map.take(context, [:servers, :disk_mb]) |> Enum.to_list())

    hub = start_hub(Path.join(folder, "hub"), server, seed, lost_s: context[:lost_s])

    dir = Path.join(folder, "companion")

    companion =
      start_gateway(dir,
        links: ["udpin:127.0.0.1:0"],
        overrides: %{
          "vehicle_id" => @vehicle,
          "nats" => companion_nats(server, hub, dir),
          "shadow" => shadow(dir),
          "remote" => %{"announce_s" => 0.5},
          "timeouts" => patient(),
          "policy" => %{
            "sources" => [%{"name" => "hub", "nkey" => nkey.public, "role" => "operator"}]
          }
        }
      )

    sim = fly(companion.gateway, "companion-sim")
    await_standing(companion.gateway)
    %{hub: hub, companion: companion, sim: sim, server: server, folder: folder, seed: seed}
  end

  defp start_hub(dir, server, seed, options) do
    start_gateway(dir,
      links: ["udpin:127.0.0.1:0"],
      overrides:
        Map.merge(hub_nats(server, options[:host] || "127.0.0.1"), %{
          "remote" => %{
            "enabled" => true,
            # Longer than anything on a busy machine stands still.
            "lost_s" => options[:lost_s] || 20,
            "announce_s" => 0.5,
            "nkey_seed_file" => seed
          },
          "shadow" => shadow(dir),
          "vehicles" => [%{"system_id" => 1, "id" => @vehicle}]
        })
    ).gateway
  end

  # Each believes the leases of the other one.
  defp shadow(dir), do: %{"dir" => Path.join(dir, "shadow"), "key" => "the key of hub and companion"}

  # One server for both, that of the hub.
  defp hub_nats(nil, _host), do: %{}

  # A server of the hub's, whose leaf node the companion's server is.
  defp hub_nats(server, host) do
    %{
      "nats" => %{
        "url" => "tls://#{host}:#{server.ports.client}",
        "nkey_seed_file" => Path.join(server.set, "hub/gateway.nk"),
        "tls" => %{"ca_file" => Path.join(server.set, "ca.pem")},
        "streams" => %{"replicas" => length(server.hosts)},
        "retry_max_ms" => 1_000
      }
    }
  end

  defp companion_nats(nil, hub, _dir), do: %{"url" => Bridge.login_url(hub)}

  defp companion_nats(server, _hub, dir) do
    own = Path.join([server.set, "vehicles", @vehicle])

    %{
      "port" => 0,
      "store_dir" => Path.join(dir, "nats"),
      "leaf" => %{
        "url" => for(host <- server.hosts, do: "tls://#{host}:#{server.ports.leaf}"),
        "nkey_seed_file" => Path.join(own, "leaf.nk"),
        "tls" => %{"ca_file" => Path.join(own, "ca.pem")}
      }
    }
  end

  defp fly(gateway, id) do
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    sim = start_supervised!({SimVehicle, [link: link] ++ fast_vehicle(:ardupilot)}, id: id)
    SimVehicle.await(sim, & &1.ready)
    sim
  end

  defp shown(hub, what, fun) do
    eventually(
      fn -> with %{} = vehicle <- Fleet.vehicle(hub, @vehicle), true <- fun.(vehicle), do: vehicle end,
      fn -> "#{what}; it is #{inspect(Fleet.vehicle(hub, @vehicle), limit: 40)}" end
    )
  end

  # Ten seconds, the usual deadline, are too few on a busy machine.
  defp command(hub, type, params \\ %{}, more \\ []) do
    more = Keyword.put_new(more, :deadline, System.os_time(:second) + 120)
    {:ok, result} = Commands.submit(hub, [vehicle: @vehicle, type: type, params: params] ++ more)
    result
  end

  defp get(hub, path) do
    {200, object} = answer(hub, path)
    object
  end

  defp answer(hub, path), do: rest(hub, :get, path)

  test "it is shown with its way and its ages, commanded, and unreachable at once when it is cut off",
       %{hub: hub, companion: companion, sim: sim} do
    vehicle =
      shown(hub, "home and mode", fn vehicle ->
        vehicle.status == :online and is_map(vehicle.groups[:home]) and is_map(vehicle.groups[:mode])
      end)

    assert %{via: @companion, gateways: [@companion], autopilot: :ardupilot, system_id: 1} = vehicle
    assert %{via: @companion, data: %{armed: false, in_air: false}} = vehicle.groups.mode
    assert Store.vehicles(hub) == []

    assert %{"vehicles" => [%{"vehicle" => @vehicle, "via" => @companion, "status" => "online"}]} =
             get(hub, "vehicles")

    assert %{"groups" => %{"mode" => %{"via" => @companion, "age" => age}}} = get(hub, "vehicles/#{@vehicle}")
    assert is_number(age)

    assert %{status: :completed, details: %{"gateway" => @companion}} =
             command(hub, "set_mode", %{mode: "GUIDED"})

    assert SimVehicle.state(sim).mode == "GUIDED"
    shown(hub, "the new mode", &(&1.groups.mode.data.mode == "GUIDED"))

    # The hub lets its own admin do it; the companion knows the hub as an operator.
    assert %{status: :denied, reason: reason, details: %{"rule" => "role"}} = command(hub, "reboot")
    assert reason =~ "hub"

    # Parameters and plans go the same way; the companion knows the hub as an operator, who has no say in parameters.
    assert {:ok, %{name: "RTL_ALT", value: value}} = Params.get(hub, @vehicle, "RTL_ALT")
    assert is_number(value)
    assert {:ok, %{params: %{"RTL_ALT" => %{value: ^value}}}} = Params.list(hub, @vehicle)
    assert {:ok, %{status: :denied, reason: reason}} = Params.set(hub, @vehicle, "RTL_ALT", value + 1)
    assert reason =~ "maintain"
    assert %{"name" => "RTL_ALT", "value" => ^value} = get(hub, "vehicles/#{@vehicle}/params/RTL_ALT")

    {:ok, plan} = Missions.import(@plan, :plan)

    assert {:ok, %{status: :completed, details: %{"gateway" => @companion}}} =
             Missions.upload(hub, @vehicle, :mission, plan)

    assert {:ok, %{plan: %{items: [_one, _two]}, items: items}} = Missions.download(hub, @vehicle, :mission)
    {:ok, %{items: ^items}} = Missions.download(companion.gateway, @vehicle, :mission)
    assert %{"kind" => "mission", "plan" => %{"mission" => _}} = get(hub, "vehicles/#{@vehicle}/mission")
    assert {:ok, %{status: :completed}} = Missions.clear(hub, @vehicle, :mission)
    assert {:ok, %{plan: %{items: []}}} = Missions.download(hub, @vehicle, :mission)

    # What is not passed on is said at once.
    for refused <- [
          Files.list(hub, @vehicle, "/"),
          Aerie.Control.Logs.list(hub, @vehicle),
          Params.metadata(hub, @vehicle),
          Params.set_all(hub, @vehicle, %{"RTL_ALT" => 1})
        ] do
      assert {_kind, %{status: :rejected, reason: reason, details: %{"rule" => "elsewhere"}}} = refused
      assert reason =~ "not available for a remote vehicle" and reason =~ @companion
    end

    for path <- ~w(files/ logs logs/1 metadata/params params?format=param signing events) do
      assert {421, %{"error" => %{"code" => "misdirected", "message" => message}, "rule" => "elsewhere"}} =
               answer(hub, "vehicles/#{@vehicle}/#{path}"),
             path

      assert message =~ @companion
    end

    assert %{status: :completed} = command(hub, "arm")
    assert %{status: :completed} = command(hub, "takeoff", %{altitude: 10})

    # The same id is not done twice, whoever asks.
    again = [id: "once-1"]
    assert %{status: :completed} = command(hub, "hold", %{}, again)
    assert %{status: :completed} = command(hub, "hold", %{}, again)

    stop_gateway(companion)

    # What was on its way while it stopped is unknown.
    assert %{status: :failed, reason: why, details: %{"rule" => "unreachable"}} =
             eventually(fn -> with %{status: :unknown} <- command(hub, "rtl"), do: nil end, "an answer")

    assert why =~ "nothing was sent"
    lost = shown(hub, "lost", &(&1.status == :lost))

    assert {:error, %{status: :failed, details: %{"rule" => "unreachable"}}} =
             Params.get(hub, @vehicle, "RTL_ALT")

    assert {:ok, %{status: :failed, details: %{"rule" => "unreachable"}}} =
             Missions.clear(hub, @vehicle, :mission)

    assert %{groups: %{mode: %{data: %{mode: mode}, at: at}}, via: @companion} = lost
    assert is_binary(mode)
    assert System.os_time(:microsecond) - at > 0
    assert %{status: :failed, details: %{"rule" => "unreachable"}} = command(hub, "rtl")
  end

  test "heard both ways it is one vehicle: shown by the hub's own link while that hears it, commanded by its holder",
       %{hub: hub, sim: remote} do
    shown(hub, "the companion tells of it", &(&1.via == @companion and &1.status == :online))
    near = fly(hub, "hub-sim")
    shown(hub, "the own link", &(&1.via == nil and &1.status == :online and &1.gateways == [@companion]))
    assert [%{id: @vehicle}] = Fleet.vehicles(hub)
    # It is shown as heard here, but the companion holds it, so a command goes by that one.
    assert %{status: :completed, details: %{"gateway" => @companion}} =
             command(hub, "set_mode", %{mode: "LOITER"})

    assert SimVehicle.state(remote).mode == "LOITER"
    refute SimVehicle.state(near).mode == "LOITER"

    stop_supervised!("hub-sim")
    shown(hub, "the companion again", &(&1.via == @companion and &1.status == :online))
    # The hub has left the subject to the companion.
    eventually(fn -> Bridge.Commands.vehicles(hub) == [] end, "the hub listens for it no more")
    assert %{status: :completed} = command(hub, "set_mode", %{mode: "GUIDED"})
    assert SimVehicle.state(remote).mode == "GUIDED"
  end

  test "what the stream kept is shown with its age by a hub that starts when the companion is gone",
       %{hub: hub, companion: companion} do
    shown(hub, "what it is, and a position", &(&1.autopilot == :ardupilot and is_map(&1.groups[:position])))
    stop_gateway(companion)
    for {id, _name, _what} <- Fleet.Remote.Table.gateways(hub), do: Fleet.Remote.Table.forget(hub, id)
    Process.exit(Aerie.Base.Names.whereis(hub, :remote_listener), :kill)

    vehicle =
      shown(
        hub,
        "from the stream",
        &(&1.status == :lost and &1.autopilot == :ardupilot and is_map(&1.groups[:position]))
      )

    assert vehicle.via == @companion
    assert vehicle.groups.position.at < System.os_time(:microsecond)
  end

  @tag :leaf
  test "through a leaf node: the same; while the hub's server is gone nothing is sent, and then it goes on",
       %{hub: hub, sim: sim, server: server} do
    vehicle = shown(hub, "home", &(&1.status == :online and is_map(&1.groups[:home])))
    assert %{via: @companion, autopilot: :ardupilot} = vehicle

    assert %{status: :completed, details: %{"gateway" => @companion}} =
             command(hub, "set_mode", %{mode: "GUIDED"})

    assert SimVehicle.state(sim).mode == "GUIDED"
    assert %{status: :denied, details: %{"rule" => "role"}} = command(hub, "reboot")

    HubServer.kill(server)
    eventually(fn -> Bridge.connection(hub) == nil end, "the hub's gateway has lost its server")

    assert %{status: :failed, details: %{"rule" => "unreachable"}} =
             command(hub, "set_mode", %{mode: "LOITER"})

    shown(hub, "lost", &(&1.status == :lost))
    assert SimVehicle.state(sim).mode == "GUIDED"

    HubServer.restart(server)
    shown(hub, "online again", &(&1.status == :online))
    assert %{status: :completed} = command(hub, "set_mode", %{mode: "LOITER"})
    assert SimVehicle.state(sim).mode == "LOITER"
  end

  @tag :leaf
  @tag servers: 3
  test "two hubs on a cluster of three servers: both show the vehicle, and what both command is done once",
       %{hub: one, sim: sim, server: server, folder: folder, seed: seed} do
    other = start_hub(Path.join(folder, "other-hub"), server, seed, host: "127.0.0.2")
    hubs = [one, other]
    for hub <- hubs, do: shown(hub, "a mode", &(&1.via == @companion and is_map(&1.groups[:mode])))
    # The servers of a cluster tell each other who listens, each in its time.
    for {hub, mode} <- [{one, "LOITER"}, {other, "GUIDED"}] do
      eventually(
        fn -> match?(%{status: :completed}, command(hub, "set_mode", %{mode: mode})) end,
        "each commands it"
      )

      assert SimVehicle.state(sim).mode == mode
    end

    for hub <- hubs, do: shown(hub, "the new mode", &(&1.groups.mode.data.mode == "GUIDED"))

    # The one id on both at the same time: the gateway aboard knows it.
    results =
      hubs
      |> Enum.map(&Task.async(fn -> command(&1, "arm", %{}, id: "both") end))
      |> Task.await_many(Aerie.Patience.ms())

    for result <- results, do: assert(%{status: :completed} = result)
    assert [%{"command" => "arm", "decision" => "allow"}] = done(folder, "both")

    # A server of the three is gone. If the vehicle or a hub was connected to it, it finds another one; until then it is
    # unreachable.
    HubServer.kill(server, "127.0.0.3")

    eventually(
      fn -> match?(%{status: :completed}, command(other, "disarm")) end,
      "it is commanded by the servers that are left"
    )

    for hub <- hubs, do: shown(hub, "disarmed", &(&1.groups.mode.data.armed == false))
  end

  # What the companion let through, of a command.
  defp done(folder, id) do
    for %{"id" => ^id, "type" => "decision"} = record <- CommandCase.audit(Path.join(folder, "companion")),
        do: record
  end

  @tag :leaf
  # Its threads have to be seen to stop before the hub misses it; a little later its gateway restarts it.
  @tag lost_s: 10
  test "through a leaf node whose server is frozen: a command is answered, and is not done after its deadline",
       %{hub: hub, sim: sim, folder: folder} do
    shown(hub, "a mode", &(&1.status == :online and is_map(&1.groups[:mode])))
    assert %{status: :completed} = command(hub, "set_mode", %{mode: "GUIDED"})
    pid = folder |> Path.join("companion/nats/nats-server.pid") |> File.read!() |> String.trim()
    signal = fn name -> assert {_, 0} = System.cmd("kill", ["-#{name}", pid]) end
    signal.("STOP")
    # A thread that runs stops a moment later.
    eventually(fn -> Enum.all?(states(pid), &(&1 == "T")) end, "all its threads have stopped")
    # Not over when the hub looks at it, but before the server goes on.
    deadline = System.os_time(:second) + 9

    under_way =
      Task.async(fn -> command(hub, "set_mode", %{mode: "LOITER"}, id: "frozen", deadline: deadline) end)

    # It falls silent for the hub after lost_s.
    assert %{status: :unknown, reason: "the gateway gateway-VID-001 fell silent" <> _} =
             Task.await(under_way, Aerie.Patience.ms())

    # Another one is refused at once.
    assert %{status: :failed, details: %{"rule" => "unreachable"}} = command(hub, "set_mode", %{mode: "RTL"})
    eventually(fn -> System.os_time(:second) > deadline end, "the deadline has passed")
    signal.("CONT")
    shown(hub, "online again", &(&1.status == :online))

    # What comes after it on the same way is done, so the late one has arrived. Until the gateway aboard listens again,
    # and has renewed its lease, which it could not while its server was frozen, nothing is sent, which is said.
    eventually(fn -> after_thaw(hub).status == :completed end, "a command is completed again")

    assert SimVehicle.state(sim).mode == "BRAKE"
    # Its audit log has everything that it let through.
    refute Enum.any?(done(folder, "frozen"), &(&1["decision"] == "allow")), inspect(modes(hub))
    # Asked again, the companion says what became of it.
    assert %{status: status} = command(hub, "set_mode", %{mode: "LOITER"}, id: "frozen", deadline: deadline)
    assert status in [:unknown, :expired]
    assert SimVehicle.state(sim).mode == "BRAKE"
  end

  defp after_thaw(hub) do
    result = command(hub, "set_mode", %{mode: "BRAKE"})
    assert result.status == :completed or result.details["rule"] in ["holder", "unreachable"], inspect(result)
    result
  end

  defp states(pid) do
    for file <- Path.wildcard("/proc/#{pid}/task/*/stat"), {:ok, text} <- [File.read(file)] do
      text |> String.split(") ") |> List.last() |> String.first()
    end
  end

  # All modes that the vehicle was in, by its events.
  defp modes(hub) do
    conn = Bridge.connection(hub)
    # Together, or at a hub in a stream of each vehicle.
    {:ok, %{streams: streams}} = Gnat.Jetstream.API.Stream.list(conn)

    for "FLEET_EVENTS" <> _vehicle = name <- streams,
        {:ok, %{state: %{last_seq: last}}} = Gnat.Jetstream.API.Stream.info(conn, name),
        seq <- 1..last//1,
        {:ok, %{data: text}} <- [Gnat.Jetstream.API.Stream.get_message(conn, name, %{seq: seq})],
        %{"type" => "mode_change", "data" => %{"to" => mode}} <- [JSON.decode!(text)],
        do: mode
  end

  @tag :leaf
  @tag disk_mb: 8
  @tag skip:
         System.cmd("unshare", ["-rm", "true"], stderr_to_stdout: true) |> elem(1) != 0 &&
           "no namespaces here"
  test "the hub's disk was full: both gateways name its server and the mend, until it is restarted",
       %{hub: hub, companion: companion, server: server} do
    Process.flag(:trap_exit, true)
    shown(hub, "a mode", &(&1.status == :online and is_map(&1.groups[:mode])))
    eventually(fn -> stores?(companion.gateway) and match?({200, _ready}, ready(hub)) end, "all is well")
    filler = HubServer.fill_disk(server)

    for _ <- 1..10,
        mode <- ["LOITER", "GUIDED"],
        do: assert(%{status: :completed} = command(companion.gateway, "set_mode", %{mode: mode}))

    for seq <- 1..10 do
      event = Event.new("G", "statustext", seq, seq, nil, %{"text" => String.duplicate("x", 4_000)})
      :ok = Journal.commit(hub, "G", :some_state, [event])
    end

    # Room alone does not help.
    stores = fn -> ready(companion.gateway) |> elem(1) |> get_in(["nats", "hub", "stores"]) end
    eventually(fn -> stores.() == false end, "the companion says it")
    eventually(fn -> match?({503, _not_ready}, ready(hub)) end, "the hub's gateway says it")
    File.rm!(filler)
    mend = "make room and restart it: after a failed write nats-server stores nothing until then"

    # Aboard all is well but for the hub.
    text =
      eventually(
        fn ->
          with {200, %{"nats" => %{"problem" => nil, "hub" => %{"problem" => text}}}} <-
                 ready(companion.gateway),
               do: text,
               else: (_not_ready -> nil)
        end,
        "the companion's gateway is ready"
      )

    assert text =~ "the hub's nats-server was full, " <> mend

    eventually(
      fn ->
        with {503, %{"nats" => %{"problem" => "" <> text}}} <- ready(hub),
             do: text =~ "nats-server at tls://127.0.0.1:#{server.ports.client} was full, " <> mend,
             else: (_not_yet -> false)
      end,
      "the hub's gateway names the server"
    )

    eventually(fn -> "hub_not_confirming" in conditions(companion.gateway) end, "diagnosed aboard")
    eventually(fn -> "nats_not_confirming" in conditions(hub) end, "diagnosed at the hub")

    HubServer.end_and_start(server)
    eventually(fn -> stores?(companion.gateway) end, "the companion's events are confirmed")

    eventually(
      fn -> match?({200, %{"nats" => %{"problem" => nil}}}, ready(hub)) end,
      "the hub's gateway is ready"
    )

    over = fn gateway ->
      Enum.all?(conditions(gateway), &(&1 not in ~w(hub_not_confirming nats_not_confirming)))
    end

    eventually(fn -> over.(hub) and over.(companion.gateway) end, "and the diagnosis")
  end

  defp ready(gateway), do: rest(gateway, :get, "/readyz")

  # The hub has what there is.
  defp stores?(gateway) do
    {_status, %{"nats" => %{"hub" => hub}}} = ready(gateway)
    match?(%{"connected" => true, "stores" => true, "waiting" => 0}, hub)
  end

  defp conditions(gateway), do: for(%{"name" => name} <- get(gateway, "diagnosis")["conditions"], do: name)

  @tag :leaf
  test "through a leaf node: a vehicle that was cut off is unreachable at once",
       %{hub: hub, companion: companion} do
    shown(hub, "a mode", &(&1.status == :online and is_map(&1.groups[:mode])))
    stop_gateway(companion)

    assert %{status: :failed, details: %{"rule" => "unreachable"}} =
             eventually(fn -> with %{status: :unknown} <- command(hub, "hold"), do: nil end, "an answer")

    shown(hub, "lost", &(&1.status == :lost and is_map(&1.groups[:mode])))
  end
end
