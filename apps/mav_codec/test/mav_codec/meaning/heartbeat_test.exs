defmodule MavCodec.Meaning.HeartbeatTest do
  use ExUnit.Case, async: true

  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Frame

  test "a heartbeat is read as far as it was sent (F7)" do
    assert Heartbeat.read(%Frame{id: 0, payload: <<0::32, 2, 12, 0, 0, 3>>}) == %Heartbeat{
             type: 2,
             autopilot: 12
           }

    assert Heartbeat.read(%Frame{id: 0, payload: <<0::32, 2>>}) == %Heartbeat{type: 2, autopilot: 0}
    assert Heartbeat.read(%Frame{id: 0, payload: <<0>>}) == %Heartbeat{type: 0, autopilot: 0}
    assert Heartbeat.read(%Frame{id: 1, payload: <<0>>}) == nil
  end

  test "H2: a sender that says nothing of itself is a vehicle only as the component of an autopilot" do
    vehicle? = fn type, autopilot, component ->
      frame = %Frame{id: 0, system: 42, component: component, payload: <<0::32, type, autopilot, 0, 0, 3>>}
      frame |> Heartbeat.read() |> Heartbeat.vehicle?()
    end

    # A Herelink's air unit.
    for autopilot <- [0, 8], do: refute(vehicle?.(0, autopilot, 250))
    assert vehicle?.(0, 0, 1)
    # The component id alone decides nothing (R10): Betaflight's is 200.
    assert vehicle?.(2, 0, 200)
    assert vehicle?.(0, 3, 250)
    refute vehicle?.(2, 8, 1)
  end
end
