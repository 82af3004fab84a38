defmodule Aerie.System.ReportsTest do
  @moduledoc "All EVENT messages (X3) of a simulated PX4 arrive, although its link loses some."

  use Aerie.SystemCase, async: true

  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  test "lost reports are requested again and reported once each", %{tmp_dir: folder} do
    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: %{"mavlink" => %{"local_addr" => "off"}})

    Aerie.Base.PubSub.subscribe(gateway, :events)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    {:ok, sim} = SimVehicle.start_link(firmware: :px4, ready_s: 3600.0, link: link)
    eventually(fn -> Store.vehicle(gateway, {"main", 1}) end, "the vehicle is known")

    # It is not ready and says why it does not arm; by EVENT only, because there is no ground station.
    arm =
      {:message, %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 1.0}, {254, 190}}

    SimVehicle.happen(sim, arm)
    assert_receive {:fleet, :events, %{type: "report", data: %{"sequence" => first} = data}}

    assert %{"name" => "commander_arm_denied_resolve_failures", "severity" => 2, "internal_severity" => 6} =
             data

    :ok = SimVehicle.fault(sim, :silence, true)
    for _ <- 1..3, do: SimVehicle.happen(sim, arm)
    :ok = SimVehicle.fault(sim, :silence, false)

    for n <- 1..3, sequence = rem(first + n, 65_536) do
      assert_receive {:fleet, :events, %{type: "report", data: %{"sequence" => ^sequence, "severity" => 2}}}
    end

    eventually(fn -> length(Store.vehicle(gateway, {"main", 1}).reports.recent) >= 4 end, "they are shown")
    assert Store.vehicle(gateway, {"main", 1}).reports.lost == 0
    refute_received {:fleet, :events, %{type: "report"}}
  end
end
