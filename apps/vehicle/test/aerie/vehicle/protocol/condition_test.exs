defmodule Aerie.Vehicle.Protocol.ConditionTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Protocol.{Condition, Vehicle}

  @vehicle %Vehicle{
    system: 1,
    autopilot: :ardupilot,
    kind: "copter",
    mode: "GUIDED",
    armed: true,
    in_air: false,
    vtol_state: "MC",
    mission_seq: 3,
    home: %{lat: 47.0, lon: 179.9999, alt_msl: 0.0},
    boots: 1,
    seen: %{mode: 10, in_air: 20, home: 30}
  }

  test "each is met by what the state shows, and says what is missing" do
    for {met, unmet, words} <- [
          {{:armed, true}, {:armed, false}, "it is still armed"},
          {{:in_air, false}, {:in_air, true}, "it is not in the air"},
          {{:mode, ["AUTO", "GUIDED"]}, {:mode, ["AUTO", "RTL"]}, "its mode is GUIDED, not AUTO or RTL"},
          {{:vtol_state, "MC"}, {:vtol_state, "FW"}, "its VTOL state is MC, not FW"},
          {{:mission_seq, 3}, {:mission_seq, 4}, "its current item is 3, not 4"},
          {{:booted, 0}, {:booted, 1}, "it was not seen to boot"},
          # The short way around the date line.
          {{:home, 47.0, -179.9999, 50}, {:home, 47.1, 179.9, 50}, "its home is elsewhere"}
        ] do
      assert Condition.met?(met, @vehicle)
      refute Condition.met?(unmet, @vehicle)
      assert Condition.describe(unmet, @vehicle) == words
      assert Condition.met?({:any, [unmet, met]}, @vehicle)
      refute Condition.met?({:any, [unmet]}, @vehicle)
      assert Condition.describe({:any, [unmet, met]}, @vehicle) == words
    end
  end

  test "what is not known is not met, and is said to be unknown" do
    unknown = %Vehicle{system: 1, autopilot: :px4, kind: "copter"}

    for {condition, words} <- [
          {{:armed, true}, "it is not armed"},
          {{:in_air, false}, "it is still in the air"},
          {{:mode, ["AUTO"]}, "its mode is not known, not AUTO"},
          {{:vtol_state, "FW"}, "its VTOL state is not known, not FW"},
          {{:mission_seq, 0}, "its current item is not known, not 0"},
          {{:home, 0.0, 0.0, 1.0e9}, "its home is not known"},
          {:told, "it did not report the end"}
        ] do
      refute Condition.met?(condition, unknown)
      assert Condition.describe(condition, unknown) == words
      assert Condition.seen(condition, unknown) == nil
    end
  end

  test "how recent it is, and whether it shows at once" do
    assert Condition.seen({:armed, true}, @vehicle) == 10
    assert Condition.seen({:in_air, true}, @vehicle) == 20
    assert Condition.seen({:home, 0.0, 0.0, 1}, @vehicle) == 30
    assert Condition.seen({:booted, 0}, @vehicle) == 30
    assert Condition.seen({:any, [{:vtol_state, "MC"}, {:mode, ["A"]}]}, @vehicle) == 10
    assert Condition.immediate?({:mode, ["A"]}) and Condition.immediate?({:any, [{:armed, true}]})
    for slow <- [{:in_air, true}, {:home, 0.0, 0.0, 1}, :told], do: refute(Condition.immediate?(slow))
  end
end
