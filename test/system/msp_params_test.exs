defmodule Aerie.System.MspParamsTest do
  @moduledoc "What ground stations show of the parameters of simulated Betaflight and iNav, and what they set."
  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  alias Aerie.Control.Params
  alias Params.LongNames
  alias SimVehicle.Msp

  @moduletag :tmp_dir
  @moduletag :capture_log

  @vehicles %{betaflight: 7, inav: 8}
  @changes %{
    betaflight: [p_roll: 47, align_board_roll: -12, gps_rescue_return_alt: 45],
    inav: [
      small_angle: 90,
      align_mag_roll: -300,
      nav_rth_altitude: 65_000,
      battery_capacity: 16_777_217,
      pitot_scale: 1.5,
      osd_snr_alarm: -4
    ]
  }

  defp fly(dir, firmware) do
    system = @vehicles[firmware]
    sim = start_supervised!({Msp, [firmware: firmware, uid: system]})

    %{gateway: gateway} =
      start_gateway(dir,
        links: ["msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=#{system}"],
        overrides: %{
          "timeouts" => patient(),
          "clients" => [%{"id" => "gcs", "url" => "tcpin:127.0.0.1:0"}],
          "policy" => %{
            "clients" => [%{"id" => "gcs", "role" => "admin"}]
          }
        }
      )

    eventually(
      fn -> data(gateway, :health, {"main", system})[:ready_to_arm] end,
      "#{firmware} could be armed"
    )

    port = eventually(fn -> MavRouter.Link.snapshot(gateway, "gcs").port end, "the endpoint is open")
    %{gateway: gateway, sim: sim, port: port, system: system, vehicle: "VID-00#{system}"}
  end

  for firmware <- [:betaflight, :inav],
      {peer, tag} <- [mavsdk: :mavsdk, qgc: :python, script: :python] do
    @tag tag
    test "#{peer} shows what is aboard #{firmware}, and what it sets is aboard (P2)", %{tmp_dir: dir} do
      shows_and_sets(unquote(peer), unquote(firmware), dir)
    end
  end

  defp shows_and_sets(peer, firmware, dir) do
    c = fly(dir, firmware)
    {:ok, table} = Params.list(c.gateway, c.vehicle)
    scheme = if peer == :mavsdk, do: "tcpout://", else: "tcp:"
    # MAVSDK knows no unsigned integers, and a script's number is a float.
    changes = Enum.reject(@changes[firmware], &(peer != :qgc and &1 == {:battery_capacity, 16_777_217}))
    arguments = for {name, value} <- changes, do: "#{LongNames.wire("#{name}")}=#{value}"
    url = "#{scheme}127.0.0.1:#{c.port}"
    found = findings(start_peer("msp_params.py", [peer, url, c.system | arguments]))
    told = JSON.decode!(found["all"])

    assert for(
             {name, %{value: value}} <- table.params,
             shown = told[LongNames.wire(name)],
             shown != value,
             do: {name, value, shown}
           ) == []

    left_out = for {name, %{type: 5}} <- table.params, peer == :mavsdk, do: name
    assert map_size(told) == Params.Table.count(table) - length(left_out)
    assert left_out == [] or (length(left_out) == 6 and "battery_capacity" in left_out)

    for {name, value} <- changes do
      assert {name, "True"} == {name, found["set:#{LongNames.wire("#{name}")}"]}
      {:ok, aboard} = Params.get(c.gateway, c.vehicle, "#{name}")
      assert {name, aboard.value} == {name, value}
    end
  end
end
