defmodule Aerie.System.CommandsTest do
  @moduledoc """
  Commands from `Aerie.Control.Commands.submit/2` to simulated autopilots through the whole gateway. The simulators answer as the recorded
  firmwares do, refusals and false acknowledgements included.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Commands

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} = context do
    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: %{"timeouts" => patient()})

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    fast = fast_vehicle(context[:firmware] || :ardupilot)
    {:ok, sim} = SimVehicle.start_link(Keyword.merge(fast, link: link, speed: context[:speed] || 5.0))
    SimVehicle.await(sim, & &1.ready)
    await_standing(gateway)
    %{gateway: gateway, sim: sim}
  end

  # A busy machine needs longer than the ten seconds that a command has by itself.
  defp command(gateway, type, params \\ %{}, more \\ []) do
    fields = [vehicle: "VID-001", type: type, params: params, deadline: System.os_time(:second) + 120]
    {:ok, result} = Commands.submit(gateway, Keyword.merge(fields, more))
    result
  end

  defp fly(gateway, sim, modes) do
    for mode <- modes.first, do: assert(%{status: :completed} = command(gateway, "set_mode", %{mode: mode}))
    assert %{status: :completed, details: %{"sent" => 1}} = command(gateway, "arm")
    assert %{status: :completed} = command(gateway, "takeoff", %{altitude: 10})
    SimVehicle.await(sim, &(&1.alt_rel > 8))
    %{lat: lat, lon: lon} = data(gateway, :position)
    there = %{lat: lat + 0.0003, lon: lon, altitude: 12}
    assert %{status: :completed} = command(gateway, "goto", there)
    SimVehicle.await(sim, &(&1.lat > lat + 0.0002))
    assert data(gateway, :mode)[:mode] == modes.goto
    assert %{status: :completed} = command(gateway, "hold")
    assert data(gateway, :mode)[:mode] == modes.hold
    # It is not asked: the policy knows that it flies.
    assert %{status: :denied, details: %{"rule" => "condition"}} = command(gateway, "reboot")
    assert %{status: :completed} = command(gateway, "rtl")
    assert data(gateway, :mode)[:mode] == modes.rtl
    SimVehicle.await(sim, &(not &1.armed))
  end

  test "ArduPilot: arm, take off, go, hold, return", %{gateway: gateway, sim: sim} do
    # It does not arm in STABILIZE for a take-off by command.
    fly(gateway, sim, %{first: ["GUIDED"], goto: "GUIDED", hold: "BRAKE", rtl: "RTL"})
  end

  @tag firmware: :px4
  test "PX4: arm, take off, go, hold, return", %{gateway: gateway, sim: sim} do
    fly(gateway, sim, %{first: ["AUTO_LOITER"], goto: "AUTO_LOITER", hold: "AUTO_LOITER", rtl: "AUTO_RTL"})
  end

  # Its clock shows when it booted: it has to run as ours does, and to have run for longer than a boot takes.
  for firmware <- [:ardupilot, :px4] do
    @tag speed: 1.0, firmware: firmware
    test "#{firmware}: a reboot is completed when the vehicle has booted", %{gateway: gateway, sim: sim} do
      SimVehicle.await(sim, &(&1.seconds > 10))
      assert %{status: :completed, details: %{"sent" => 1}} = command(gateway, "reboot")
    end
  end

  @tag firmware: :px4
  test "PX4: what it accepts and does not do, and what it never answers", %{gateway: gateway} do
    assert %{status: :rejected, reason: "it is not armed" <> _} = command(gateway, "takeoff", %{altitude: 5})
    # A main mode that there is not is acknowledged with "accepted", twice.
    # Without a heartbeat in time, on a busy machine, nobody knows.
    eventually(
      fn ->
        result = command(gateway, "set_mode", %{mode: "RATTITUDE"})
        assert result.status in [:failed, :unknown]
        match?(%{status: :failed, reason: "the vehicle accepted it, but its mode is" <> _}, result)
      end,
      "it is in another mode"
    )

    assert %{status: :rejected, reason: "it has no wings" <> _} =
             command(gateway, "vtol_transition", %{to: "fixed_wing"})

    assert %{status: :rejected, reason: "the vehicle answered UNSUPPORTED"} =
             command(gateway, "high_latency", %{enabled: true})

    assert %{status: :completed} = command(gateway, "request_message", %{message_id: 148})
  end

  test "a bad link: what is safe is repeated, and nothing is said to have failed that was done", context do
    %{gateway: gateway, sim: sim} = context
    :ok = SimVehicle.fault(sim, :loss, 0.3)
    :ok = SimVehicle.fault(sim, :duplicate, 0.1)

    for mode <- ~w(LOITER GUIDED ALT_HOLD GUIDED) do
      assert %{status: :completed} = command(gateway, "set_mode", %{mode: mode})
      assert SimVehicle.state(sim).mode == mode
    end
  end

  test "an unknown vehicle, a wrong parameter and a deadline that has passed", %{gateway: gateway} do
    assert {:ok, %{status: :rejected, reason: "there is no vehicle VID-009"}} =
             Commands.submit(gateway, vehicle: "VID-009", type: "arm")

    assert {:error, [%{key: "params.altitude"}]} =
             Commands.submit(gateway, vehicle: "VID-001", type: "takeoff", params: %{altitude: 5000})

    past = System.os_time(:second) - 5
    assert %{status: :expired} = command(gateway, "arm", %{}, deadline: past)
    assert data(gateway, :mode)[:armed] == false
  end
end
