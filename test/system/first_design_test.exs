defmodule Aerie.System.FirstDesignTest do
  @moduledoc """
  The unchanged gateway.yaml of the first design, which gives the gateway the ids of the vehicle's autopilot (1/1). The test
  sets only paths, port and NATS server.
  """

  use Aerie.SystemCase, async: true

  import ExUnit.CaptureLog

  @moduletag :tmp_dir

  @yaml File.read!(Path.expand("../../apps/aerie/test/fixtures/first_design.yaml", __DIR__))

  defp credentials do
    """
    -----BEGIN NATS USER JWT-----
    eyJ0eXAi
    ------END NATS USER JWT------
    -----BEGIN USER NKEY SEED-----
    #{Nkey.seed(Nkey.generate(:user))}
    ------END USER NKEY SEED------
    """
  end

  setup %{tmp_dir: dir} = context do
    file = Path.join(dir, "gateway.yaml")
    File.write!(file, String.replace(@yaml, "/etc/gateway", dir))
    File.write!(Path.join(dir, "geofence.json"), fence())
    File.write!(Path.join(dir, "vehicle.creds"), credentials())
    File.chmod!(Path.join(dir, "vehicle.creds"), 0o600)
    mavlink = Map.merge(%{"local_addr" => "127.0.0.1:0"}, context[:mavlink] || %{})
    nats = %{"mode" => "embedded", "port" => 0, "store_dir" => Path.join(dir, "nats")}
    run = start_gateway(dir, config_file: file, overrides: %{"mavlink" => mavlink, "nats" => nats})
    %{gateway: run.gateway, config: run.config}
  end

  # Around the simulated vehicles' home.
  defp fence do
    ring = [[8.5, 47.3], [8.6, 47.3], [8.6, 47.5], [8.5, 47.5], [8.5, 47.3]]
    JSON.encode!(%{type: "Feature", properties: %{}, geometry: %{type: "Polygon", coordinates: [ring]}})
  end

  defp fly(gateway, options \\ []) do
    url = "udpout:127.0.0.1:#{link_port(gateway, "udp")}"
    start_supervised!({SimVehicle, [firmware: :ardupilot, system: 1, ready_s: 1.0, link: url] ++ options})
  end

  defp ready(gateway) do
    {ready?, report} = Aerie.Fleet.Health.ready(gateway)
    {ready?, JSON.decode!(JSON.encode!(report))["identity"]}
  end

  test "sees the vehicle, as its component 191, and warns about it", %{gateway: gateway, config: config} do
    assert Enum.any?(config.warnings, &(&1 =~ "this gateway is component 191"))
    sim = fly(gateway)

    eventually(
      fn -> match?(%{id: "VID-001", status: :online}, Store.vehicle(gateway, "VID-001")) end,
      "it is there"
    )

    eventually(fn -> Store.vehicle(gateway, "VID-001").groups[:position] end, "with a position")

    eventually(fn -> SimVehicle.stats(sim).received > 0 end, "and hears us")

    eventually(
      fn -> match?({true, %{"system" => 1, "component" => 191, "alarm" => nil}}, ready(gateway)) end,
      fn -> "it is ready: #{inspect(Aerie.Fleet.Health.ready(gateway))}" end
    )

    assert %{identity: %{system: 1, component: 191}} = Aerie.Api.Rest.View.status(gateway)
  end

  @tag mavlink: %{"component_id" => 190}
  test "an autopilot with the gateway's own ids raises an alarm", %{gateway: gateway} do
    log =
      capture_log(fn ->
        fly(gateway, component: 190)
        eventually(fn -> MavRouter.Router.identity(gateway).alarm end, "it is noticed")
      end)

    assert log =~ "[error]" and log =~ "system 1, component 190"
    assert {false, %{"alarm" => alarm}} = ready(gateway)
    assert alarm =~ "system 1, component 190"

    assert {"identity", fields} = List.keyfind(Aerie.CLI.Status.Lines.render(view(gateway)), "identity", 0)
    assert fields[:ALARM] =~ "component 190"

    assert Aerie.CLI.Status.Table.render(view(gateway), 200, 40) |> Enum.any?(&(&1 =~ "ALARM: an autopilot"))
  end

  defp view(gateway) do
    now = System.os_time(:microsecond)
    struct!(%Aerie.CLI.Status.View{now: now, started: now}, identity: MavRouter.Router.identity(gateway))
  end
end
