defmodule Aerie.System.RemoteTest do
  @moduledoc "A hub and a companion with real nats-servers: the hub shows and commands a vehicle that only the companion hears."
  use Aerie.SystemCase, async: true

  alias Aerie.{Bridge, Commands, Fleet, HubServer}
  alias Gnat.Nkey

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-001"
  @companion "gateway-VID-001"

  setup %{tmp_dir: folder} = context do
    nkey = Nkey.generate(:user)
    seed = Path.join(folder, "hub.nk")
    File.write!(seed, Nkey.seed(nkey))
    File.chmod!(seed, 0o600)
    server = if context[:leaf], do: HubServer.start(folder, [@vehicle])

    hub =
      start_gateway(
        Path.join(folder, "hub"),
        links: ["udpin:127.0.0.1:0"],
        overrides:
          Map.merge(hub_nats(server), %{
            "remote" => %{"enabled" => true, "lost_s" => 3, "announce_s" => 0.5, "nkey_seed_file" => seed},
            "vehicles" => [%{"system_id" => 1, "id" => @vehicle}]
          })
      ).gateway

    dir = Path.join(folder, "companion")

    companion =
      start_gateway(dir,
        links: ["udpin:127.0.0.1:0"],
        overrides: %{
          "vehicle_id" => @vehicle,
          "nats" => companion_nats(server, hub, dir),
          "remote" => %{"announce_s" => 0.5},
          "policy" => %{
            "audit" => %{"dir" => Path.join(dir, "audit")},
            "sources" => [%{"name" => "hub", "nkey" => nkey.public, "role" => "operator"}]
          }
        }
      )

    sim = fly(companion.gateway, "companion-sim")
    await_standing(companion.gateway)
    %{hub: hub, companion: companion, sim: sim, server: server}
  end

  # One server for both, that of the hub.
  defp hub_nats(nil), do: %{}

  # A server of the hub's, whose leaf node the companion's server is.
  defp hub_nats(server) do
    %{
      "nats" => %{
        "url" => "tls://127.0.0.1:#{server.ports.client}",
        "nkey_seed_file" => Path.join(server.set, "hub/gateway.nk"),
        "tls" => %{"ca_file" => Path.join(server.set, "ca.pem")},
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
        "url" => "tls://127.0.0.1:#{server.ports.leaf}",
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

  defp command(hub, type, params \\ %{}, more \\ []) do
    {:ok, result} = Commands.submit(hub, [vehicle: @vehicle, type: type, params: params] ++ more)
    result
  end

  defp get(hub, path) do
    url = ~c"http://127.0.0.1:#{FleetWeb.Endpoint.port(hub)}/api/#{path}"

    {:ok, {{_version, 200, _reason}, _headers, body}} =
      :httpc.request(:get, {url, []}, [], body_format: :binary)

    JSON.decode!(body)
  end

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

    assert %{status: :completed} = command(hub, "arm")
    assert %{status: :completed} = command(hub, "takeoff", %{altitude: 10})

    # The same id is not done twice, whoever asks.
    again = [id: "once-1"]
    assert %{status: :completed} = command(hub, "hold", %{}, again)
    assert %{status: :completed} = command(hub, "hold", %{}, again)

    stop_gateway(companion)
    assert %{status: :failed, reason: why, details: %{"rule" => "unreachable"}} = command(hub, "rtl")
    assert why =~ "nothing was sent"
    lost = shown(hub, "lost", &(&1.status == :lost))
    assert %{groups: %{mode: %{data: %{mode: mode}, at: at}}, via: @companion} = lost
    assert is_binary(mode)
    assert System.os_time(:microsecond) - at > 0
    assert %{status: :failed, details: %{"rule" => "unreachable"}} = command(hub, "rtl")
  end

  test "heard both ways it is one vehicle: by the hub's own link while that hears it, else by the companion",
       %{hub: hub, sim: remote} do
    shown(hub, "the companion tells of it", &(&1.via == @companion and &1.status == :online))
    near = fly(hub, "hub-sim")
    shown(hub, "the own link", &(&1.via == nil and &1.status == :online and &1.gateways == [@companion]))
    assert [%{id: @vehicle}] = Fleet.vehicles(hub)
    assert %{status: :completed} = command(hub, "set_mode", %{mode: "LOITER"})
    assert SimVehicle.state(near).mode == "LOITER"
    refute SimVehicle.state(remote).mode == "LOITER"

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
    for {id, _name, _what} <- Fleet.Remote.gateways(hub), do: Fleet.Remote.forget(hub, id)
    Process.exit(Aerie.Names.whereis(hub, :remote_listener), :kill)

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
  test "through a leaf node: a vehicle that was cut off is unreachable at once",
       %{hub: hub, companion: companion} do
    shown(hub, "a mode", &(&1.status == :online and is_map(&1.groups[:mode])))
    stop_gateway(companion)
    assert %{status: :failed, details: %{"rule" => "unreachable"}} = command(hub, "hold")
    shown(hub, "lost", &(&1.status == :lost and is_map(&1.groups[:mode])))
  end
end
