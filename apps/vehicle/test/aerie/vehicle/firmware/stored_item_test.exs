defmodule Aerie.Vehicle.Firmware.StoredItemTest do
  @moduledoc """
  What comes back when an item of a plan is read again (W9): the same, or what the firmware is known to make of it.
  """
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Firmware.{Ardupilot, Px4}
  alias Protocols.Mission.StoredItem
  alias MavCodec.Enums.MavCmd

  defp item(name, params, more \\ %{}) do
    Map.merge(
      %{
        command: MavCmd.value(:"MAV_CMD_#{name}"),
        frame: 3,
        params: List.to_tuple(params),
        x: 470_000_000,
        y: 80_000_000,
        z: 20.0
      },
      more
    )
  end

  # The fields that may not come back with these values.
  defp differing(kept, read),
    do:
      for({field, value} <- read, expected = kept[field], not StoredItem.match?(expected, value), do: field)
      |> Enum.sort()

  test "ArduPilot keeps one number of a waypoint, and its height in centimetres" do
    kept = Ardupilot.StoredItem.item(item(:NAV_WAYPOINT, [2.7, 1.0, 0.0, 90.0], %{z: 20.006}), 0, "copter")
    assert differing(kept, %{param1: 2.0, param2: 0.0, param4: 0.0, z: 20.0, x: 470_000_000, frame: 3}) == []
    assert differing(kept, %{param1: 2.7, z: 20.006}) -- [:param1, :z] == []
    assert differing(kept, %{z: 21.0, x: 470_000_001}) == [:x, :z]
    # Planes keep two radii in one byte each.
    plane = Ardupilot.StoredItem.item(item(:NAV_WAYPOINT, [0.0, 300.0, 12.9, 0.0]), 0, "plane")
    assert differing(plane, %{param2: 255.0, param3: 12.0}) == []
  end

  test "ArduPilot's turns, signs, flags, wide radii and numbers of newer versions" do
    turns = &Ardupilot.StoredItem.item(item(:NAV_LOITER_TURNS, &1), 0, "copter")
    assert differing(turns.([0.5, 0.0, -40.0, 2.0]), %{param1: 0.5, param3: -40.0, param4: 1.0}) == []
    # Older ones know no part of a turn.
    assert differing(turns.([0.5, 0.0, 10.0, 0.0]), %{param1: 0.0, param3: 10.0}) == []
    assert differing(turns.([3.0, 0.0, 1234.0, nil]), %{param1: 3.0, param3: 1230.0, param4: nil}) == []
    assert differing(turns.([3.0, 0.0, 1234.0, 0.0]), %{param3: 1234.0}) == [:param3]

    land = &Ardupilot.StoredItem.item(item(:NAV_VTOL_LAND, [&1, 0.0, 0.0, 0.0]), 0, "vtol")
    assert differing(land.(7.0), %{param1: 7.0}) == [] and differing(land.(7.0), %{param1: 0.0}) == []
    circle = &Ardupilot.StoredItem.item(item(:NAV_LOITER_TIME, [10.0, 0.0, &1, 0.0]), 0, "copter")
    assert differing(circle.(-50.0), %{param3: -1.0}) == [] and differing(circle.(nil), %{param3: 1.0}) == []
    far = Ardupilot.StoredItem.item(item(:NAV_LOITER_UNLIM, [0.0, 0.0, -300.4, 0.0]), 0, "copter")
    assert differing(far, %{param3: -300.0}) == []
    winch = Ardupilot.StoredItem.item(item(:DO_ENGINE_CONTROL, [1.0, 0.0, 1.234, 1.0]), 0, "copter")
    assert differing(winch, %{param1: 1.0, param3: 1.23, param4: 0.0, x: 0, frame: 0}) == []
    half = Ardupilot.StoredItem.item(item(:NAV_SCRIPT_TIME, [1.0, 2.0, 0.1, 3.0]), 0, "copter")
    assert differing(half, %{param3: 0.09998, param4: 3.0}) == []
  end

  test "a number beyond what is kept has to come back as it is" do
    speed = Ardupilot.StoredItem.item(item(:DO_SET_RELAY, [300.0, 1.0, 0.0, 0.0]), 0, "copter")
    assert differing(speed, %{param1: 44.0}) == [:param1]
    assert differing(speed, %{param1: 300.0}) == []
  end

  test "a command that is not known counts as a whole, and one without a place has none" do
    unknown =
      Ardupilot.StoredItem.item(%{item(:NAV_WAYPOINT, [1.0, nil, 3.0, 4.0]) | command: 65_000}, 0, "copter")

    assert differing(unknown, %{param2: 0.0, autocontinue: 0}) == []
    refute is_map_key(unknown, :param1)
    assert unknown.frame == [3]
  end

  test "fences keep corners and radii, rally points whole metres" do
    fence = &Ardupilot.StoredItem.item(item(&1, [&2, 0.0, 0.0, 0.0]), 1, "copter")
    assert differing(fence.(:NAV_FENCE_POLYGON_VERTEX_INCLUSION, 4.0), %{param1: 3.0}) == [:param1]
    assert differing(fence.(:NAV_FENCE_CIRCLE_EXCLUSION, 30.5), %{param1: 30.0}) == []
    assert differing(fence.(:NAV_FENCE_RETURN_POINT, 1.0), %{param1: 9.0, z: 1.0}) == []
    rally = Ardupilot.StoredItem.item(item(:NAV_RALLY_POINT, [0.0, 0.0, 0.0, 0.0], %{z: 20.7}), 2, "copter")
    assert differing(rally, %{z: 20.0}) == [] and differing(rally, %{z: 21.0}) == [:z]
    px4 = &Px4.StoredItem.item(item(&1, [&2, 0.0, 0.0, 0.0]), 1, "copter")
    assert differing(px4.(:NAV_FENCE_POLYGON_VERTEX_EXCLUSION, 4.0), %{param1: 4.0, z: 0.0}) == []
    assert differing(px4.(:NAV_FENCE_CIRCLE_INCLUSION, 30.5), %{param1: 30.0}) == [:param1]
    assert differing(px4.(:NAV_FENCE_RETURN_POINT, 1.0), %{param1: 9.0}) == []

    assert differing(Px4.StoredItem.item(item(:NAV_RALLY_POINT, [1.0, 0.0, 0.0, 0.0]), 2, "copter"), %{
             param1: 0.0
           }) == []
  end

  test "PX4 keeps the yaw as a direction, flags and unset values; commands without a place keep everything" do
    waypoint = Px4.StoredItem.item(item(:NAV_WAYPOINT, [1.5, 2.0, 9.0, -90.0]), 0, "copter")
    assert differing(waypoint, %{param1: 1.5, param2: 2.0, param3: 0.0, param4: 270.0001}) == []
    assert differing(waypoint, %{param4: 90.0, param1: 1.0}) == [:param1, :param4]
    free = Px4.StoredItem.item(item(:NAV_WAYPOINT, [nil, 2.0, 9.0, nil]), 0, "copter")
    assert differing(free, %{param1: 0.0, param4: nil}) == [] and differing(free, %{param4: 0.0}) == [:param4]
    land = Px4.StoredItem.item(item(:NAV_LAND, [0.0, 2.0, 0.0, 0.0]), 0, "copter")
    assert differing(land, %{param2: 2.0}) == []
    loiter = Px4.StoredItem.item(item(:NAV_LOITER_TIME, [10.0, 5.0, 50.0, -1.0]), 0, "copter")
    assert differing(loiter, %{param2: 1.0, param4: 0.0}) == []

    jump = Px4.StoredItem.item(item(:DO_JUMP, [3.0, -1.0, nil, 0.0], %{frame: 2}), 0, "copter")
    assert differing(jump, %{param1: 3.0, param2: 65_535.0, param3: nil}) == []
    assert differing(jump, %{param1: 2.0}) == [:param1]
    delay = Px4.StoredItem.item(item(:CONDITION_DELAY, [3.0, 0.0, 0.0, 0.0], %{frame: 2}), 0, "copter")
    assert differing(delay, %{command: MavCmd.value(:MAV_CMD_NAV_DELAY)}) == []
    refute is_map_key(Px4.StoredItem.item(item(:DO_SET_SERVO, [1.0, 2.0, 0.0, 0.0]), 0, "copter"), :param1)
  end

  test "a difference too small to be named" do
    assert StoredItem.same?([1.0], 0.1, 0.10000000149)
    refute StoredItem.same?([1.0], 0.1, 0.1001)
    assert StoredItem.same?({:angle, 359.9999, 1.0e-3}, 359.9999, 0.0)
    assert StoredItem.same?(:any, nil, 5.0)
    refute StoredItem.same?(:any, 5.0, nil)
    assert StoredItem.same?([1], 1, 1)
    refute StoredItem.match?({:near, [1.0], 0.1}, nil)
    assert StoredItem.match?([nil, 0.0], nil)
    assert StoredItem.match?([0.0], -0.0)
  end
end
