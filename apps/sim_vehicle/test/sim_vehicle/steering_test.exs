defmodule SimVehicle.SteeringTest do
  @moduledoc "What the firmwares make of set-points, overrides and homes; each test names the function whose rule it shows."
  use ExUnit.Case, async: true

  import SimVehicle.TestFlight

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle

  defp local(mask, fields),
    do:
      struct!(
        %M.SetPositionTargetLocalNed{
          target_system: 1,
          target_component: 1,
          coordinate_frame: 1,
          type_mask: mask
        },
        fields
      )

  defp stream(flight, message, seconds),
    do: Enum.reduce(1..(seconds * 5), flight, fn _fifth, flight -> flight |> hear(message) |> run(0.2) end)

  test "ArduCopter takes no notice of a position of which one axis is masked (GCS_MAVLINK_Copter::handle_message_set_position_target_local_ned)" do
    flight = flying(:ardupilot)
    # The place is to the south, the velocity to the north.
    assert vehicle(stream(flight, local(0xDC1, x: -50.0, z: -20.0, vx: 5.0), 4)).kin.n > 10
    # Nothing is left of it: it stops.
    moving = stream(flight, local(0xDC7, vx: 5.0), 2)
    assert abs(vehicle(moving |> hear(local(0xDC9, x: -50.0, vx: 5.0, z: -20.0)) |> run(10)).kin.vn) < 0.5
    # The height alone is not a position either.
    assert abs(vehicle(stream(flight, local(0xDFB, z: -60.0), 4)).kin.d + 20) < 2
  end

  test "ArduCopter flies on from a place with a velocity, until its time-out (ModeGuided::set_destination_posvelaccel)" do
    flight = flying(:ardupilot) |> hear(local(0xDC0, x: 5.0, z: -20.0, vx: 5.0)) |> run(12)
    assert_in_delta vehicle(flight).kin.n, 20, 2
  end

  test "ArduCopter keeps a velocity for GUID_TIMEOUT, and an acceleration makes it grow (ModeGuided::set_velaccel, set_accel)" do
    flight = flying(:ardupilot)
    assert vehicle(flight |> hear(local(0xDC7, vx: 5.0)) |> run(10)).kin.n > 7
    assert -vehicle(stream(flight, local(0xC3F, afz: -2.0), 8)).kin.d > 30
    assert vehicle(flight |> hear(local(0xC07, vx: 0.5, afx: 2.0)) |> run(2.5)).kin.vn > 2
  end

  test "PX4 goes by axis, takes NaN for masked, and climbs by an acceleration alone (MavlinkReceiver::handle_message_set_position_target_local_ned)" do
    offboard = fn message ->
      flying(:px4) |> stream(local(0xDF8, z: -20.0), 2) |> mode([1.0, 6.0]) |> stream(message, 6) |> vehicle()
    end

    assert %{mode: "OFFBOARD", kin: %{d: d, n: n}} = offboard.(local(0xDE3, z: -30.0, vx: 3.0))
    assert -d > 24 and n > 5
    assert -offboard.(local(0xC3F, afz: -2.0)).kin.d > 25
    assert offboard.(local(0xDC0, x: :nan, y: :nan, z: -20.0, vx: 3.0)).kin.n > 5
    # Its place in the body's frame counts nothing.
    assert abs(offboard.(%{local(0xDF8, x: 50.0, z: -20.0) | coordinate_frame: 8}).kin.n) < 2
  end

  test "home is what heights are measured from, and may be moved in flight (GCS_MAVLINK::handle_command_do_set_home)" do
    flight = flying(:ardupilot) |> command(179, [1.0])
    assert_in_delta Vehicle.relative_altitude(vehicle(flight)), 0, 1
  end

  test "ArduPilot takes overrides of SYSID_MYGCS only, and shows them (GCS_MAVLINK::handle_rc_channels_override)" do
    ignore = Map.new(1..8, &{:"chan#{&1}_raw", 65_535})
    override = &struct!(%M.RcChannelsOverride{target_system: 1, target_component: 1}, Map.merge(ignore, &1))
    flight = flying(:ardupilot)
    shown = fn flight -> flight |> run(2) |> sent(M.RcChannels) |> List.last() end

    assert shown.(hear(flight, override.(%{chan6_raw: 1700}), {245, 191})).chan6_raw == 1000
    assert shown.(hear(flight, override.(%{chan6_raw: 1700}))).chan6_raw == 1700
    assert shown.(hear(flight, %M.ManualControl{target: 1, z: 500})).chan3_raw == 1500
  end

  test "the mode channel changes the mode by its position (RC_Channel::read_6pos_switch)" do
    override =
      &%M.RcChannelsOverride{
        target_system: 1,
        chan1_raw: 65_535,
        chan2_raw: 65_535,
        chan3_raw: 65_535,
        chan4_raw: 65_535,
        chan5_raw: &1
      }

    flight = flying(:ardupilot)
    assert vehicle(hear(flight, override.(1300))).mode == "LAND"
    assert vehicle(hear(flight, override.(1400))).mode == "RTL"
    assert vehicle(hear(flight, override.(1400), {245, 191})).mode == "GUIDED"
  end

  test "a disarmed rover keeps a target, and drives off when it is armed (GCS_MAVLINK_Rover::handle_command_int_do_reposition)" do
    target = %M.CommandInt{
      target_system: 1,
      target_component: 1,
      command: 192,
      frame: 6,
      param1: -1.0,
      param2: 1.0
    }

    {v, _log} = flight = ready(:ardurover)
    flight = hear(flight, %{target | x: v.origin.lat + 5_000, y: v.origin.lon})
    assert {192, 0} in acks(flight)
    assert vehicle(run(flight, 5)).kin.n == 0.0
    assert vehicle(flight |> command(400, [1.0]) |> run(10)).kin.n > 30
  end
end
