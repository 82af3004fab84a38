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

  test "H2, R10: a vehicle is who says that it has an autopilot and is nothing else" do
    vehicle? = fn type, autopilot -> Heartbeat.vehicle?(%Heartbeat{type: type, autopilot: autopilot}) end
    for {type, autopilot} <- [{2, 3}, {1, 12}, {0, 0}, {99, 3}], do: assert(vehicle?.(type, autopilot))
    refute vehicle?.(2, 8)
    for not_a_vehicle <- [6, 18, 26, 30, 34], do: refute(vehicle?.(not_a_vehicle, 3))
  end
end
