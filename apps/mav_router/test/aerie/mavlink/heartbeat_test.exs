defmodule Aerie.Mavlink.HeartbeatTest do
  use ExUnit.Case, async: true

  alias Aerie.Mavlink.Heartbeat
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
end
