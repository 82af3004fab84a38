defmodule Aerie.System.QGCTest do
  @moduledoc """
  QGroundControl's conversation with several vehicles at once (`test/peers/qgc_gcs.py`, because the program itself needs a
  screen), over each of its connections: its listening UDP port, called directly or by broadcast, and TCP.
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  alias MavRouter.Client

  @moduletag :tmp_dir
  @moduletag :python

  setup %{tmp_dir: folder} do
    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], stations: ["maintain"])
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    for {firmware, system} <- [ardupilot: 1, px4: 2, ardupilot: 3] do
      options = [firmware: firmware, system: system, link: link, ready_s: 1.0]
      start_supervised!({SimVehicle, options}, id: system)
    end

    eventually(fn -> length(Store.vehicles(gateway)) == 3 end, "all vehicles are known")
    {:ok, gateway: gateway}
  end

  # The result of every conversation: vehicles answer what they know and refuse the rest.
  defp assert_talked(findings, more \\ fn _found -> %{} end) do
    for system <- 1..3 do
      found = for {name, value} <- findings, [^system, key] <- [key(name)], into: %{}, do: {key, value}
      firmware = if system == 2, do: :px4, else: :ardupilot

      assert found == firmware |> expected(found) |> Map.merge(more.(found)),
             "system #{system}: #{inspect(found)}"

      # Ten a second, as requested, or more if another client wants more; four without a request. A vehicle that gets too little time
      # sends a little less.
      assert String.to_integer(found["attitude_ms"]) in 10..200
    end

    assert findings["strangers"] == "0"
  end

  defp key(name) do
    case String.split(name, ".", parts: 2) do
      [system, key] -> [String.to_integer(system), key]
      _other -> nil
    end
  end

  defp expected(firmware, found) do
    common = %{
      "version" => "came",
      "attitude_ms" => found["attitude_ms"],
      "ftp" => "answered",
      "params" => "True",
      "gaps" => "True",
      "mission" => "same",
      "fence" => "same",
      "rally" => "same",
      "logs" => "0"
    }

    Map.merge(common, answers(firmware))
  end

  defp answers(:ardupilot), do: %{"protocol" => "failed", "modes" => "failed", "metadata" => "failed"}

  defp answers(:px4),
    # PX4 accepts every request for a message, and sends those that it has.
    do: %{
      "protocol" => "accepted",
      "modes" => "accepted",
      "metadata" => "accepted",
      "interval" => "accepted"
    }

  test "its listening port, called by the gateway", c do
    port = free_udp_port()
    qgc = start_peer("qgc_gcs.py", ["udpin:127.0.0.1:#{port}", "1,2,3"])
    {:ok, _id} = Client.add(c.gateway, "udpout:127.0.0.1:#{port}")
    assert_talked(findings(qgc))
  end

  test "its listening port, found by broadcast, and from then on the only address that the gateway sends to",
       c do
    port = free_udp_port()
    qgc = start_peer("qgc_gcs.py", ["udpin:0.0.0.0:#{port}", "1,2,3"])
    {:ok, id} = Client.add(c.gateway, "udpbcast:127.255.255.255:#{port}")
    assert_talked(findings(qgc))
    assert [_only_address] = Enum.filter(Client.list(c.gateway), &(&1.owner == id))
  end

  # The second one may request items that came for the first one; that changes no plan. A vehicle's files are one station's at
  # a time: the other one's question may wait longer than it does.
  defp looked(found),
    do: %{
      "gaps" => found["gaps"],
      "ftp" => found["ftp"],
      "mission" => "came",
      "fence" => "came",
      "rally" => "came"
    }

  test "two at once that call the gateway, by TCP and by UDP", c do
    {:ok, tcp} = Client.add(c.gateway, "tcpin:127.0.0.1:0")
    {:ok, udp} = Client.add(c.gateway, "udpin:127.0.0.1:0", id: "second")
    port = fn id -> Enum.find(Client.endpoints(c.gateway), &(&1.id == id)).port end
    one = start_peer("qgc_gcs.py", ["tcp:127.0.0.1:#{port.(tcp)}", "1,2,3"])
    two = start_peer("qgc_gcs.py", ["udpout:127.0.0.1:#{port.(udp)}", "1,2,3", 254, "look"])
    assert_talked(findings(one), &Map.take(&1, ["gaps", "ftp"]))
    assert_talked(findings(two), &looked/1)
  end
end
