defmodule Aerie.System.PeersTest do
  @moduledoc """
  MAVSDK, MAVProxy and pymavlink as ground stations of a gateway with an ArduCopter and a PX4 behind it. Each connects,
  reads telemetry and all parameters, sets one, loads a mission up and down, arms, takes off, lands; always two at once,
  by two ways in, and neither disturbs the other.
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  alias MavRouter.Client

  @moduletag :tmp_dir
  @moduletag :python

  # What each script prints after a successful flight; the parameters that it changes are floats.
  @copter ["ardupilot", 1, "PILOT_TKOFF_ALT"]
  @px4 ["px4", 2, "MIS_TAKEOFF_ALT"]

  setup %{tmp_dir: folder} = context do
    options = [links: ["udpin:127.0.0.1:0"], stations: ["maintain"], overrides: context[:config] || %{}]
    %{gateway: gateway} = run = start_gateway(folder, options)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    copter = vehicle(:ardupilot, [link: link, system: 1], context)
    px4 = vehicle(:px4, [link: link, system: 2], context)
    eventually(fn -> length(Store.vehicles(gateway)) == 2 end, "both vehicles are known")
    %{gateway: gateway, config: run.config, copter: copter, px4: px4}
  end

  # A fast vehicle's patience with a ground station is short: the ten seconds for a mission's next item are two of ours at
  # speed 5, which a peer on a busy machine needs.
  defp vehicle(firmware, options, context) do
    fast = fast_vehicle(firmware, (firmware == :ardupilot && context[:params]) || %{})
    options = options ++ Keyword.put(fast, :speed, context[:speed] || 2.0)
    start_supervised!({SimVehicle, options}, id: firmware)
  end

  defp endpoint(gateway, client) do
    {:ok, id} = Client.add(gateway, client)
    Enum.find(Client.endpoints(gateway), &(&1.id == id)).port
  end

  defp assert_flown(findings, mission) do
    assert %{"battery" => "True", "set" => "True", "same" => "True", "arm" => "armed", "land" => "disarmed"} =
             findings

    assert %{"lat" => "-35.3633", "mission" => ^mission, "takeoff" => _climbed} = findings
    assert String.to_integer(findings["params"]) > 150
  end

  defp assert_landed(sims) do
    for sim <- sims, do: assert(%{armed: false} = SimVehicle.state(sim))
  end

  @tag :mavsdk
  @tag :mavproxy
  test "MAVSDK by UDP with PX4, MAVProxy by TCP with ArduPilot", c do
    udp = endpoint(c.gateway, "udpin:127.0.0.1:0")
    tcp = endpoint(c.gateway, "tcpin:127.0.0.1:0")
    mavsdk = start_peer("mavsdk_gcs.py", ["udpout://127.0.0.1:#{udp}" | @px4])
    mavproxy = start_peer("mavproxy_gcs.py", ["tcp:127.0.0.1:#{tcp}" | @copter])
    assert_flown(findings(mavsdk), "[22, 16, 21]")
    flown = findings(mavproxy)
    assert_flown(flown, "[16, 22, 16, 21]")
    assert %{"files" => _size} = flown
    assert_landed([c.copter, c.px4])
  end

  # MAVSDK is system 245, component 190.
  @tag :mavsdk
  @tag :mavproxy
  @tag config: %{"mavlink" => %{"local_addr" => "off", "system_id" => 245}}, params: %{"SYSID_MYGCS" => 245}
  test "MAVSDK by TCP with ArduPilot, MAVProxy with PX4 by UDP called by the gateway; the gateway tells its own system id from MAVSDK's",
       c do
    Aerie.Base.PubSub.subscribe(c.gateway, :events)
    tcp = endpoint(c.gateway, "tcpin:127.0.0.1:0")
    port = free_udp_port()
    mavproxy = start_peer("mavproxy_gcs.py", ["udpin:127.0.0.1:#{port}" | @px4])
    {:ok, _id} = Client.add(c.gateway, "udpout:127.0.0.1:#{port}")
    mavsdk = start_peer("mavsdk_gcs.py", ["tcpout://127.0.0.1:#{tcp}" | @copter])

    eventually(
      fn -> match?(%{gcs: %{quiet?: true, heard_gcs: 245}}, Store.vehicle(c.gateway, {"main", 1})) end,
      "it is the ground station that the failsafe listens to"
    )

    assert_flown(findings(mavsdk), "[16, 22, 16, 21]")
    assert_receive {:fleet, :events, %{type: "gcs.lost", data: %{"system" => 245}}}
    assert_flown(findings(mavproxy), "[16, 22, 16, 21]")
    assert_landed([c.copter, c.px4])
  end

  @tag :mavproxy
  test "pymavlink and MAVProxy fly what the gateway serves them parameters and plans of", c do
    udp = endpoint(c.gateway, %{url: "udpin:127.0.0.1:0", id: "one", served: true})
    tcp = endpoint(c.gateway, %{url: "tcpin:127.0.0.1:0", id: "two", served: true})
    pymavlink = start_peer("pymavlink_gcs.py", ["udpout:127.0.0.1:#{udp}" | @px4] ++ [254])
    mavproxy = start_peer("mavproxy_gcs.py", ["tcp:127.0.0.1:#{tcp}" | @copter])
    assert_flown(findings(pymavlink), "[22, 16, 21]")
    assert_flown(findings(mavproxy), "[16, 22, 16, 21]")
    assert_landed([c.copter, c.px4])
    assert Map.new(Store.counters(c.gateway))[:served_messages] > 100
  end

  @tag speed: 1.0
  test "two ground stations repeatedly upload missions to one PX4 at once, and all are accepted", c do
    [one, two] =
      for {scheme, source} <- [{"udpin", 255}, {"tcpin", 254}] do
        port = endpoint(c.gateway, "#{scheme}:127.0.0.1:0")
        address = if scheme == "udpin", do: "udpout:127.0.0.1:#{port}", else: "tcp:127.0.0.1:#{port}"
        start_peer("pymavlink_uploads.py", [address, 2, 60, 8, source])
      end

    for peer <- [one, two], do: assert(%{"results" => "[0, 0, 0, 0, 0, 0, 0, 0]"} = findings(peer))
  end

  @key "a-key-for-the-tests-0123"
  @tag config: %{"api" => %{"key" => @key}}
  test "pymavlink by WebSocket, with a ticket, with ArduPilot; pymavlink by mavlink.sock with PX4", c do
    websocket = Aerie.Api.WebSocket.port(c.gateway)
    socket = Path.join(c.config.sockets.dir, "mavlink.sock")

    one =
      start_peer("pymavlink_gcs.py", ["ws:127.0.0.1:#{websocket}:/?ticket=#{ticket(c.gateway)}" | @copter])

    two = start_peer("pymavlink_gcs.py", ["unix:#{socket}" | @px4] ++ [254])
    assert_flown(findings(one), "[16, 22, 16, 21]")
    assert_flown(findings(two), "[22, 16, 21]")
    assert_landed([c.copter, c.px4])
  end

  defp ticket(gateway) do
    {201, %{"ticket" => ticket}} = rest(gateway, :post, "tickets", %{}, key: @key)
    ticket
  end

  test "a script reads state.sock: both vehicles, ten times a second", c do
    peer = start_peer("state_reader.py", [Path.join(c.config.sockets.dir, "state.sock"), 30])
    findings = findings(peer)
    assert findings["vehicles"] == "VID-001 VID-002"
    assert findings["modes"] =~ "STABILIZE"
    # Counted by the times in the lines; a busy machine sends fewer, never more.
    assert String.to_float(findings["hz"]) < 11.0
  end
end

defmodule Aerie.System.OneIdTest do
  @moduledoc "A hub with two radios, on each of them a vehicle with system id 1, and one ground station that flies both."

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  @moduletag :tmp_dir
  @moduletag :python

  test "pymavlink flies both through one endpoint, under the ids that the endpoint gives them (id_offsets)",
       %{
         tmp_dir: folder
       } do
    url = "tcpin:127.0.0.1:0"
    clients = [%{"id" => "both", "url" => url, "id_offsets" => %{"north" => 10}}]

    links =
      for network <- ["main", "north"],
          do: %{"id" => network, "url" => "udpin:127.0.0.1:0", "network" => network}

    %{gateway: gateway} =
      start_gateway(folder, stations: ["maintain"], overrides: %{"links" => links, "clients" => clients})

    sims =
      for {firmware, network} <- [ardupilot: "main", px4: "north"] do
        link = "udpout:127.0.0.1:#{link_port(gateway, network)}"
        options = [system: 1, link: link] ++ fast_vehicle(firmware)
        start_supervised!({SimVehicle, options}, id: firmware)
      end

    eventually(fn -> length(Store.vehicles(gateway)) == 2 end, "both vehicles are known")
    port = MavRouter.Link.snapshot(gateway, "both").port

    peers =
      for arguments <- [["ardupilot", 1, "PILOT_TKOFF_ALT"], ["px4", 11, "MIS_TAKEOFF_ALT", 254]],
          do: start_peer("pymavlink_gcs.py", ["tcp:127.0.0.1:#{port}" | arguments])

    for peer <- peers do
      assert %{"set" => "True", "same" => "True", "arm" => "armed", "land" => "disarmed", "params" => params} =
               findings(peer)

      assert String.to_integer(params) > 150
    end

    for sim <- sims, do: assert(%{armed: false} = SimVehicle.state(sim))
    # The gateway has each under its own id, and no collision.
    assert [%{key: {"main", 1}, collision: nil}, %{key: {"north", 1}, collision: nil}] =
             Store.vehicles(gateway)
  end
end
