defmodule Aerie.Vehicle.Firmware.UnknownTest do
  @moduledoc "A firmware that is not known: its messages mean what MAVLink declares, and what it does not say may hurt."

  use ExUnit.Case, async: true

  alias Aerie.Vehicle.State
  alias MavCodec.Messages, as: M

  @second_us 1_000_000

  defp state(messages, autopilot \\ :generic, kind \\ "copter") do
    Enum.reduce(messages, %State{autopilot: autopilot, kind: kind}, fn %module{} = message, state ->
      {state, _groups} = State.apply(state, module.id(), message, @second_us)
      state
    end)
  end

  defp value(state, group, key), do: state |> State.data(group) |> Map.fetch!(key)

  test "values are those of MAVLink" do
    assert [%M.RcChannels{rssi: 254}] |> state() |> value(:rc, :rssi) == 1.0
    assert [%M.SysStatus{current_battery: -100}] |> state() |> value(:battery, :current) == -1.0
    place = %M.GlobalPositionInt{lat: 1, lon: 1, alt: 9_000, relative_alt: 4_000}
    assert [place] |> state() |> value(:position, :alt_rel) == 4.0
    assert [place, %M.Altitude{altitude_relative: 7.0}] |> state() |> value(:position, :alt_rel) == 4.0
  end

  test "a summary by satellite does not say whether it is armed" do
    state = state([%M.HighLatency2{autopilot: 0, type: 2, custom_mode: 7, custom0: -128}])
    assert {value(state, :mode, :custom_mode), value(state, :mode, :armed)} == {7, nil}
    assert [%M.HighLatency2{autopilot: 3, type: 2, custom0: -128}] |> state() |> value(:mode, :armed) == true
  end

  test "its status says nothing about flying, and disarmed it may fall" do
    for status <- [3, 4] do
      armed = state([%M.Heartbeat{autopilot: 0, type: 2, base_mode: 0x80, system_status: status}])
      assert value(armed, :mode, :in_air) == nil
      assert State.Flight.aloft?(armed)
    end

    flying = state([%M.Heartbeat{autopilot: 3, type: 2, base_mode: 0x80, system_status: 4}], :ardupilot)
    assert value(flying, :mode, :in_air) == true
    refute State.Flight.aloft?(flying)
    refute [%M.ExtendedSysState{landed_state: 1}] |> state() |> State.Flight.aloft?()
  end

  test "no mode and no state makes a plane a quadplane" do
    beat = %M.Heartbeat{autopilot: 0, type: 1, base_mode: 1, custom_mode: 19}
    assert state([beat, %M.ExtendedSysState{vtol_state: 3}], :generic, "plane").kind == "plane"
    assert state([%{beat | autopilot: 3}], :ardupilot, "plane").kind == "vtol"
  end
end
