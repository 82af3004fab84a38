defmodule Aerie.System.AloneTest do
  @moduledoc "A gateway with a nats-server of its own goes on commanding its vehicle when that server is gone: nobody else can hold it."
  use Aerie.SystemCase, async: true

  import Aerie.BridgeCase, only: [server_pid: 1]

  alias Aerie.Control.Commands

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-001"

  test "its server stands still for longer than the lease lasts", %{tmp_dir: dir} do
    %{gateway: gateway} =
      start_gateway(dir,
        links: ["udpin:127.0.0.1:0"],
        overrides: %{
          "vehicle_id" => @vehicle,
          "timeouts" => patient(),
          "shadow" => %{"dir" => Path.join(dir, "shadow"), "lease_s" => 1}
        }
      )

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    sim = start_supervised!({SimVehicle, [link: link] ++ fast_vehicle(:ardupilot)})
    SimVehicle.await(sim, & &1.ready)
    await_standing(gateway)
    assert %{status: :completed, details: %{"once" => "gateway"}} = mode(gateway, "GUIDED")
    {_, 0} = System.cmd("kill", ["-STOP", server_pid(dir)])

    # The shadow says when it has noticed.
    eventually(
      fn -> match?({:held, "nats", _why}, Aerie.Fleet.Shadow.Documents.authority(gateway, @vehicle)) end,
      "the lease has ended"
    )

    assert %{status: :completed, details: %{"once" => "gateway"}} = mode(gateway, "LOITER")
    assert SimVehicle.state(sim).mode == "LOITER"
  end

  defp mode(gateway, mode) do
    more = [params: %{mode: mode}, deadline: System.os_time(:second) + 60]
    {:ok, result} = Commands.submit(gateway, [vehicle: @vehicle, type: "set_mode"] ++ more)
    result
  end
end
