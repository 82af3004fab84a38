defmodule Aerie.System.RoutersTest do
  @moduledoc """
  mavlink-router and mavp2p between the gateway and a ground station, and between a vehicle and the gateway, each by UDP
  and TCP and calling or called. The whole flight goes through them (telemetry, parameters, a mission up and down, arming,
  take-off, landing), so that the gateway must meet a router's expectations (heartbeats, one address per system, nothing
  sent back: R1, R2, R3).
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2, start_program: 2]

  alias MavRouter.Client

  @moduletag :tmp_dir
  @moduletag :python

  @copter ["ardupilot", 1, "PILOT_TKOFF_ALT"]
  @px4 ["px4", 2, "MIS_TAKEOFF_ALT"]

  setup %{tmp_dir: folder} do
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], stations: ["maintain"])
    {:ok, gateway: gateway, link: link_port(gateway, "link-1"), folder: folder}
  end

  defp vehicles(c) do
    sim("udpout:127.0.0.1:#{c.link}", :ardupilot, 1)
    sim("udpout:127.0.0.1:#{c.link}", :px4, 2)
    known(c.gateway)
  end

  defp sim(link, firmware, system) do
    options = [system: system, link: link] ++ fast_vehicle(firmware)
    start_supervised!({SimVehicle, options}, id: system)
  end

  defp known(gateway),
    do: eventually(fn -> length(Store.vehicles(gateway)) == 2 end, "both vehicles are known")

  defp endpoint(gateway, url) do
    {:ok, id} = Client.add(gateway, url)
    Enum.find(Client.endpoints(gateway), &(&1.id == id)).port
  end

  defp mavlink_router(folder, tcp, endpoints) do
    file = Path.join(folder, "mavlink-router-#{tcp}.conf")
    sections = for {head, lines} <- endpoints, do: ["[", head, "]\n", Enum.map(lines, &[&1, "\n"]), "\n"]
    File.write!(file, ["[General]\nTcpServerPort = #{tcp}\n\n" | sections])
    start_program("mavlink-routerd", ["-c", file])
  end

  defp fly(address, [_firmware, system, _parameter] = vehicle, mission) do
    findings = "pymavlink_gcs.py" |> start_peer([address | vehicle]) |> findings()

    assert %{"battery" => "True", "set" => "True", "same" => "True", "arm" => "armed", "land" => "disarmed"} =
             findings

    assert %{"mission" => ^mission, "takeoff" => _climbed} = findings
    assert findings["system"] == "#{system}"
    assert String.to_integer(findings["params"]) > 150
  end

  defp fly_copter(address), do: fly(address, @copter, "[16, 22, 16, 21]")
  defp fly_px4(address), do: fly(address, @px4, "[22, 16, 21]")

  describe "mavlink-router" do
    @describetag :mavlink_router

    test "is a client by TCP, with a ground station behind it", c do
      vehicles(c)
      tcp = free_tcp_port()
      ours = endpoint(c.gateway, "tcpin:127.0.0.1:0")
      mavlink_router(c.folder, tcp, [{"TcpEndpoint gateway", ["Address = 127.0.0.1", "Port = #{ours}"]}])
      fly_copter("tcp:127.0.0.1:#{tcp}")
    end

    test "is a client by UDP, with a ground station behind it", c do
      vehicles(c)
      tcp = free_tcp_port()
      ours = endpoint(c.gateway, "udpin:127.0.0.1:0")

      mavlink_router(c.folder, tcp, [
        {"UdpEndpoint gateway", ["Mode = Normal", "Address = 127.0.0.1", "Port = #{ours}"]}
      ])

      fly_px4("tcp:127.0.0.1:#{tcp}")
    end

    test "is called by UDP, and by TCP", c do
      vehicles(c)
      {tcp, udp} = {free_tcp_port(), free_udp_port()}

      mavlink_router(c.folder, tcp, [
        {"UdpEndpoint gateway", ["Mode = Server", "Address = 127.0.0.1", "Port = #{udp}"]}
      ])

      {:ok, "by-udp"} = Client.add(c.gateway, "udpout:127.0.0.1:#{udp}", id: "by-udp")
      fly_px4("tcp:127.0.0.1:#{tcp}")
      :ok = Client.remove(c.gateway, "by-udp")

      # The same router, by the port that ground stations use.
      {:ok, "by-tcp"} = Client.add(c.gateway, "tcp:127.0.0.1:#{tcp}", id: "by-tcp")
      fly_copter("tcp:127.0.0.1:#{tcp}")
    end

    test "is between the vehicles and the gateway", c do
      {tcp, udp} = {free_tcp_port(), free_udp_port()}

      mavlink_router(c.folder, tcp, [
        {"UdpEndpoint one", ["Mode = Server", "Address = 127.0.0.1", "Port = #{udp}"]},
        {"UdpEndpoint gateway", ["Mode = Normal", "Address = 127.0.0.1", "Port = #{c.link}"]}
      ])

      # One by a UDP server, which answers the last sender, one by TCP.
      sim("udpout:127.0.0.1:#{udp}", :ardupilot, 1)
      sim("tcp:127.0.0.1:#{tcp}", :px4, 2)
      known(c.gateway)
      ours = endpoint(c.gateway, "tcpin:127.0.0.1:0")
      fly_px4("tcp:127.0.0.1:#{ours}")
      fly_copter("tcp:127.0.0.1:#{ours}")
    end
  end

  describe "mavp2p" do
    @describetag :mavp2p

    test "is a client by TCP, with a ground station behind it", c do
      vehicles(c)
      tcp = free_tcp_port()
      ours = endpoint(c.gateway, "tcpin:127.0.0.1:0")
      start_program("mavp2p", ["tcpc:127.0.0.1:#{ours}", "tcps:127.0.0.1:#{tcp}"])
      fly_px4("tcp:127.0.0.1:#{tcp}")
    end

    test "is a client by UDP, with a ground station behind it", c do
      vehicles(c)
      tcp = free_tcp_port()
      ours = endpoint(c.gateway, "udpin:127.0.0.1:0")
      start_program("mavp2p", ["udpc:127.0.0.1:#{ours}", "tcps:127.0.0.1:#{tcp}"])
      fly_copter("tcp:127.0.0.1:#{tcp}")
    end

    test "is called by UDP, and is between a vehicle and the gateway", c do
      {tcp, udp} = {free_tcp_port(), free_udp_port()}
      start_program("mavp2p", ["udps:127.0.0.1:#{udp}", "udpc:127.0.0.1:#{c.link}"])
      sim("udpout:127.0.0.1:#{udp}", :ardupilot, 1)
      sim("udpout:127.0.0.1:#{c.link}", :px4, 2)
      known(c.gateway)
      other = free_udp_port()
      start_program("mavp2p", ["udps:127.0.0.1:#{other}", "tcps:127.0.0.1:#{tcp}"])
      {:ok, _id} = Client.add(c.gateway, "udpout:127.0.0.1:#{other}")
      fly_copter("tcp:127.0.0.1:#{tcp}")
    end
  end
end
