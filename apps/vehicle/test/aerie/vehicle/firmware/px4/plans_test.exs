defmodule Aerie.Vehicle.Firmware.Px4.PlansTest do
  @moduledoc "W10: PX4 may reject a plan after it has acknowledged it."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Firmware.Px4.Plans
  alias MavCodec.Messages, as: M

  @mission 0
  @fence 1

  test "an error among its events rejects the mission, a warning does not" do
    event = %M.Event{id: 22_271_714, log_levels: 0x33}

    assert {:invalid, "PX4 rejected it after the upload: it needs a take-off"} =
             Plans.verdict(event, @mission, 7)

    assert Plans.verdict(%{event | log_levels: 0x34}, @mission, 7) == :ignore
    assert Plans.verdict(event, @fence, 7) == :ignore
    assert Plans.verdict(%{event | id: 1}, @mission, 7) == :ignore
    assert {:invalid, text} = Plans.verdict(%M.Event{id: 27_750_677, log_levels: 0x44}, @fence, nil)
    assert text =~ "home"
  end

  test "so does its text, and MISSION_CURRENT of the new plan shows what became of it" do
    assert {:invalid, text} =
             Plans.verdict(%M.Statustext{text: "Mission rejected: no landing "}, @mission, nil)

    assert text =~ ~r/no landing\z/
    current = &%M.MissionCurrent{mission_id: 7, mission_state: &1}
    assert {:doubtful, _} = Plans.verdict(current.(1), @mission, 7)
    assert Plans.verdict(current.(2), @mission, 7) == :valid
    assert Plans.verdict(current.(0), @mission, 7) == :ignore
    for other <- [8, 0, nil], do: assert(Plans.verdict(current.(2), @mission, other) == :ignore)
  end

  test "a mission is watched longest, rally points not at all" do
    assert Plans.watch_us(@mission) > Plans.watch_us(@fence)
    assert Plans.watch_us(2) == 0
  end
end
