defmodule Aerie.Vehicle.QuadplaneTest do
  @moduledoc """
  ArduPlane with rotors: its heartbeat says FIXED_WING by default (Q_MAV_TYPE 0), and it takes off and lands as a VTOL.
  """
  use ExUnit.Case, async: true

  import Aerie.CommandSamples
  import Aerie.Flight, only: [frame: 2, frames: 1, run: 1]

  alias Aerie.Vehicle.Protocol
  alias Aerie.Vehicle.Firmware.Ardupilot.Adapter
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @beat %M.Heartbeat{type: 1, autopilot: 3, base_mode: 89, custom_mode: 15, system_status: 3}

  defp kind(messages, beat \\ @beat) do
    frames =
      for {message, n} <- Enum.with_index([beat] ++ messages ++ [beat]), do: frame(message, n * @second)

    run(frames).core.state.kind
  end

  defp param(value),
    do: %M.ParamValue{param_id: "Q_ENABLE", param_value: value, param_type: 2, param_index: 65_535}

  test "ArduPlane 4.7 in its recorded flight is one" do
    assert %{kind: "vtol", autopilot: :ardupilot} = run(frames("arduplane_47_quadplane_vtol")).core.state
  end

  test "its VTOL state, Q_ENABLE or a mode shows it that only a quadplane has, whichever comes" do
    assert kind([%{@beat | custom_mode: 19}]) == "vtol"
    assert kind([%{@beat | custom_mode: 12}]) == "plane"
    assert kind([]) == "plane"
    assert kind([%M.ExtendedSysState{vtol_state: 0, landed_state: 1}, param(0.0)]) == "plane"
    for state <- 1..4, do: assert(kind([%M.ExtendedSysState{vtol_state: state, landed_state: 1}]) == "vtol")
    assert kind([param(1.0)]) == "vtol"
    # A copter says MC, and PX4 its type.
    assert kind([%M.ExtendedSysState{vtol_state: 3}], %{@beat | type: 2}) == "copter"
    assert kind([%M.ExtendedSysState{vtol_state: 3}], %{@beat | autopilot: 12}) == "plane"
  end

  # Plane's GCS_MAVLINK: NAV_TAKEOFF is for quadplanes in GUIDED (QuadPlane::do_user_takeoff); QLAND lands.
  test "it takes off in GUIDED, and lands in QLAND" do
    on_ground = vehicle(:ardupilot, %{kind: "vtol", mode: "QLOITER", armed: true, in_air: false})
    steps = fn type, params, vehicle -> Protocol.plan(Adapter, command(type, params), vehicle) end
    assert {:ok, [mode, takeoff]} = steps.("takeoff", %{altitude: 20}, on_ground)
    assert [%M.CommandLong{command: 176, param2: 15.0}] = Adapter.encode(mode, 0, on_ground)
    assert [%M.CommandLong{command: 22, param7: 20.0}] = Adapter.encode(takeoff, 0, on_ground)
    assert {:ok, [land]} = steps.("land", %{}, %{on_ground | in_air: true})
    assert [%M.CommandLong{command: 176, param2: 20.0}] = Adapter.encode(land, 0, on_ground)
    assert {:gap, _reason} = steps.("takeoff", %{altitude: 20}, %{on_ground | kind: "plane"})
  end
end
