defmodule Aerie.Vehicle.Firmware.RecordedTest do
  @moduledoc """
  What adapters send, byte for byte against what pymavlink sent to real firmware in flights that were recorded, where that
  was answered as it should be.
  """
  use ExUnit.Case, async: true

  import Aerie.CommandSamples

  alias Aerie.Vehicle.{Firmware, Protocol}
  alias MavCodec.{Dialects, Message, Tlog}

  @fixtures Path.expand("../../../fixtures", __DIR__)
  # Home of PX4's simulator, from its HOME_POSITION.
  @px4_home 489.5660095214844

  defp recorded(name) do
    for %MavCodec.Frame{} = frame <- Tlog.Reader.stream!(Path.join(@fixtures, name <> "_tx.tlog")),
        do: {frame.id, frame.payload}
  end

  defp sent(vehicle, name, params) do
    protocol = Firmware.of(vehicle.autopilot)
    {:ok, steps} = Protocol.plan(protocol, command(name, params), vehicle)

    for step <- steps, message <- protocol.encode(step, 0, vehicle) do
      {:ok, id, _crc_extra, payload} = Message.encode_payload(message, 2, Dialects.All)
      {id, payload}
    end
  end

  defp check(recording, vehicle, cases) do
    recorded = recorded(recording)

    for {name, params} <- cases, frame <- sent(%{vehicle | in_air: name != "takeoff"}, name, params) do
      assert frame in recorded, "#{name} #{inspect(params)} is not in #{recording}: #{inspect(frame)}"
    end
  end

  test "ArduCopter 4.6.3: a whole flight" do
    vehicle = vehicle(:ardupilot, %{mode: "GUIDED"})

    check("arducopter_flight", vehicle, [
      {"arm", %{}},
      {"set_mode", %{mode: "guided"}},
      {"takeoff", %{altitude: 20}},
      {"mission_set_current", %{seq: 1}},
      {"resume", %{}},
      {"set_mode", %{standard_mode: "safe_recovery"}},
      {"set_mode", %{standard_mode: "mission"}},
      {"set_message_interval", %{message_id: 30, rate: 20}},
      {"request_message", %{message_id: 148}},
      {"setpoint_position", %{lat: -35.3627220, lon: 149.1655603, altitude: 20}},
      {"setpoint_velocity", %{vx: 0, vy: 3, vz: 0}}
    ])

    # From another mode a take-off begins with GUIDED.
    check("arducopter_flight", %{vehicle | mode: "STABILIZE"}, [{"takeoff", %{altitude: 20}}])
  end

  test "PX4 1.17: a whole flight" do
    home = %{lat: 47.397742, lon: 8.545594, alt_msl: @px4_home}
    vehicle = vehicle(:px4, %{home: home})
    place = %{lat: 47.3979673, lon: 8.5453312}

    check("px4_flight", vehicle, [
      {"arm", %{}},
      {"takeoff", %{altitude: 12}},
      {"goto", Map.merge(place, %{altitude: 18})},
      {"set_speed", %{speed: 6}},
      {"hold", %{}},
      {"set_mode", %{mode: "OFFBOARD"}},
      {"mission_set_current", %{seq: 0}},
      {"mission_start", %{}},
      {"mission_pause", %{}},
      {"resume", %{}},
      {"land", %{}},
      {"set_message_interval", %{message_id: 36, rate: 10}},
      {"request_message", %{message_id: 435}}
    ])
  end

  test "PX4 1.17: an orbit is that of the recording but for the turns, which MAVLink declares as 0" do
    home = %{lat: 47.397742, lon: 8.545594, alt_msl: @px4_home}
    params = %{lat: 47.3979673, lon: 8.5453312, altitude: 18, radius: 8, speed: 3}

    [{75, <<before::binary-12, _turns::binary-4, rest::binary>>}] =
      sent(vehicle(:px4, %{home: home}), "orbit", params)

    assert Enum.any?(recorded("px4_flight"), fn
             {75, <<^before::binary-12, _nan::binary-4, ^rest::binary>>} -> true
             _other -> false
           end)
  end

  test "PX4 1.17: what it refuses" do
    check("px4_refusals", vehicle(:px4), [
      {"disarm", %{}},
      {"force_disarm", %{}},
      {"terminate", %{}},
      {"prearm_check", %{}},
      {"reboot", %{}},
      {"reset_params", %{}},
      {"calibrate", %{sensor: "gyro"}},
      {"calibrate", %{sensor: "accelerometer"}},
      {"set_mode", %{standard_mode: "land"}},
      {"set_mode", %{standard_mode: "position_hold"}},
      {"set_home", %{lat: 47.3977428, lon: 8.5455967, altitude_msl: @px4_home}}
    ])
  end
end
