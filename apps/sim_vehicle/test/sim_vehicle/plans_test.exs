defmodule SimVehicle.PlansTest do
  @moduledoc """
  The storage of plans, by the source of the firmwares: ArduPilot's AP_Mission.cpp (`mavlink_int_to_mission_cmd`,
  `mission_cmd_to_mavlink_int`, `sanity_check_params`), AP_Rally.h and AC_PolyFence_loader.cpp, PX4's mavlink_mission.cpp
  (`parse_mavlink_mission_item`, `format_mavlink_mission_item`).
  """
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias SimVehicle.Plans

  @station {255, 190}
  @item %{
    seq: 1,
    frame: 3,
    command: 16,
    current: 0,
    autocontinue: 1,
    params: {0.0, 0.0, 0.0, 0.0},
    x: 471_000_000,
    y: 81_000_000,
    z: 20.0
  }

  defp stored(style, type, fields) do
    plans = Plans.put(Plans.new(style), type, [Map.merge(@item, Map.new(fields))])
    [item] = Plans.items(plans, type)
    item
  end

  # The command, what was sent, and what ArduCopter 4.7 reads back.
  @copter [
    {16, {2.5, 5.0, 1.0, 90.0}, {2.0, 0.0, 0.0, 0.0}},
    {17, {1.0, 0.0, -80.7, 90.0}, {0.0, 0.0, -80.0, 0.0}},
    {18, {2.5, 0.0, -301.0, 1.0}, {2.0, 0.0, -300.0, 1.0}},
    {18, {0.5, 0.0, 2557.0, 0.0}, {0.5, 0.0, 2550.0, 0.0}},
    {19, {10.0, 1.0, 0.0, 0.0}, {10.0, 0.0, 1.0, 0.0}},
    {21, {0.0, 0.0, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}},
    {21, {0.0, 0.0, 0.0, :nan}, {0.0, 0.0, 0.0, 1.0}},
    {22, {15.0, 0.0, 0.0, 90.0}, {15.0, 0.0, 0.0, 0.0}},
    {31, {1.0, -90.0, 0.0, 1.0}, {0.0, -90.0, 0.0, 1.0}}
  ]

  test "ArduPilot: an item with a place keeps one number of 16 bits" do
    for {command, sent, kept} <- @copter do
      item = stored(:ardupilot, 0, command: command, params: sent)
      assert {command, item.params} == {command, kept}
      assert %{frame: 3, x: 471_000_000, y: 81_000_000} = item
    end
  end

  test "ArduPilot: heights are cut to centimetres, frames are those of a place" do
    assert_in_delta stored(:ardupilot, 0, z: 20.125).z, 20.12, 1.0e-5
    assert_in_delta stored(:ardupilot, 0, z: -20.129).z, -20.12, 1.0e-5

    for {sent, read} <- [{0, 0}, {2, 0}, {5, 0}, {3, 3}, {6, 3}, {10, 10}, {11, 10}],
        do: assert(stored(:ardupilot, 0, frame: sent).frame == read)
  end

  test "ArduPilot: other commands keep their structure, and neither frame nor place" do
    for {command, sent, kept} <- [
          {20, {1.0, 2.0, 3.0, 4.0}, {0.0, 0.0, 0.0, 0.0}},
          {93, {2.5, -1.0, 12.0, 30.5}, {2.5, -1.0, 12.0, 30.0}},
          {115, {45.5, 10.0, -1.0, 1.0}, {45.5, 10.0, -1.0, 1.0}},
          {177, {2.0, -1.0, 5.0, 0.0}, {2.0, -1.0, 0.0, 0.0}},
          {178, {1.0, 5.0, -1.0, 1.0}, {1.0, 5.0, -1.0, 0.0}},
          {183, {9.0, 1500.5, 0.0, 0.0}, {9.0, 1500.0, 0.0, 0.0}},
          {206, {25.5, 1000.0, 1.0, 0.0}, {25.5, 0.0, 1.0, 0.0}}
        ] do
      item = stored(:ardupilot, 0, command: command, params: sent)
      assert {command, item.params} == {command, kept}
      assert %{frame: 0, x: 0, y: 0, z: +0.0, autocontinue: 1} = item
    end

    assert %{z: 2.0} = stored(:ardupilot, 0, command: 205, z: 0.0)
    assert %{x: 1, y: 2, z: +0.0} = stored(:ardupilot, 0, command: 203, x: 1, y: 2)
    # A byte: 10000000 is 0x989680.
    assert %{x: 128} = stored(:ardupilot, 0, command: 203, x: 10_000_000)
    assert %{x: 12, y: 0, z: 1.0} = stored(:ardupilot, 0, command: 1000, x: 12, y: 5, z: 1.0)
  end

  test "ArduPilot: rally points have whole metres, and a fence has no heights" do
    assert %{z: 20.0, frame: 3} = stored(:ardupilot, 2, command: 5100, z: 20.9)

    assert %{params: {50.5, +0.0, +0.0, +0.0}, z: +0.0, frame: 0} =
             stored(:ardupilot, 1, command: 5003, params: {50.5, 1.0, 0.0, 0.0})

    assert %{params: {+0.0, +0.0, +0.0, +0.0}} =
             stored(:ardupilot, 1, command: 5000, params: {1.0, 0.0, 0.0, 0.0})
  end

  test "PX4: the yaw is in radians, between 0 and a turn; other commands are others" do
    for {sent, read} <- [
          {1.0, 1.0},
          {10.0, 10.0},
          {123.4, 123.4},
          {359.5, 359.5},
          {-90.0, 270.0},
          {450.0, 90.0}
        ] do
      %{params: {hold, radius, +0.0, yaw}} = stored(:px4, 0, params: {2.5, 3.5, 1.0, sent})
      assert {hold, radius} == {2.5, 3.5}
      assert_in_delta yaw, read, 1.0e-4
    end

    assert %{params: {_, _, _, :nan}} = stored(:px4, 0, params: {0.0, 0.0, 0.0, :nan})
    assert %{params: {+0.0, +0.0, +0.0, +0.0}} = stored(:px4, 0, command: 22, params: {15.0, 0.0, 0.0, 0.0})
    assert %{params: {3.0, 1.0, 50.0, +0.0}} = stored(:px4, 0, command: 19, params: {3.0, 1.0, 50.0, -1.0})

    assert %{command: 93, params: {5.0, _, _, _}} =
             stored(:px4, 0, command: 112, frame: 2, params: {5.0, 0.0, 0.0, 0.0})

    assert %{params: {2.0, 65_535.0, _, _}} =
             stored(:px4, 0, command: 177, frame: 2, params: {2.0, -1.0, 0.0, 0.0})

    assert %{x: 120, z: 1.0} = stored(:px4, 0, command: 1000, frame: 2, x: 120, z: 1.0)
  end

  defp upload(style, item) do
    plans = Plans.new(style)
    {plans, _request} = Plans.handle(plans, %M.MissionCount{count: 1}, @station, nil, 0)
    Plans.handle(plans, item, @station, nil, 1)
  end

  test "ArduPilot refuses NaN in most parameters, and no place beyond the globe in what has none" do
    nan = %M.MissionItemInt{
      command: 16,
      frame: 3,
      param1: 0.0,
      param2: :nan,
      param3: 0.0,
      param4: :nan,
      z: 1.0
    }

    assert {_plans, [%M.MissionAck{type: 7}]} = upload(:ardupilot, nan)
    assert {_plans, [%M.MissionAck{type: 0} | _]} = upload(:ardupilot, %{nan | param2: 0.0})
    assert {_plans, [%M.MissionAck{type: 0} | _]} = upload(:px4, nan)

    far = %M.MissionItemInt{
      command: 203,
      frame: 3,
      param1: 0.0,
      param2: 0.0,
      param3: 0.0,
      param4: 0.0,
      x: 2_000_000_000,
      z: 0.0
    }

    assert {_plans, [%M.MissionAck{type: 0} | _]} = upload(:ardupilot, far)
    assert {_plans, [%M.MissionAck{type: 10}]} = upload(:ardupilot, %{far | command: 16})
  end

  test "MISSION_ITEM has degrees only for a place" do
    float = %M.MissionItem{
      command: 203,
      frame: 3,
      param1: 0.0,
      param2: 0.0,
      param3: 0.0,
      param4: 0.0,
      x: 1.0,
      y: 0.0,
      z: 0.0
    }

    {plans, _ack} = upload(:ardupilot, float)
    assert [%{x: 1}] = Plans.items(plans, 0)

    assert {_plans, [%M.MissionItem{x: 1.0}]} =
             Plans.handle(plans, %M.MissionRequest{seq: 0}, @station, nil, 2)

    {plans, _ack} = upload(:ardupilot, %{float | command: 16, x: 47.1})
    assert [%{x: 471_000_000}] = Plans.items(plans, 0)
  end
end
