defmodule Aerie.Fleet.Missions.VariantTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Geo.Earth
  alias Aerie.Fleet.Missions.Variant
  alias Protocols.Mission.{Item, Plan}

  defp item(fields \\ []),
    do: struct!(%Item{command: 16, frame: 3, x: 473_977_000, y: 85_456_000, z: 20.0}, fields)

  defp by(east, north, up), do: %{east: east, north: north, up: up}
  defp point(item), do: Earth.point(item.x / 1.0e7, item.y / 1.0e7)

  test "the first vehicle has the plan as it is, each other one is so far beside the one before" do
    plan = %Plan{items: [item(), item(frame: 0, z: 500.0), item(frame: 10, z: 30.0)]}
    assert {:ok, ^plan} = Variant.offset(plan, 0, by(10, -20, 3))
    assert {:ok, moved} = Variant.offset(plan, 2, by(10, -20, 3))

    for {was, is} <- Enum.zip(plan.items, moved.items) do
      assert_in_delta Earth.distance(point(was), point(is)), :math.sqrt(20 * 20 + 40 * 40), 0.02
      assert is.x < was.x and is.y > was.y
      assert is.z == was.z + 6
    end
  end

  test "what has no place, what a camera looks at, fences and jumps stay; a landing moves on its ground" do
    still = [
      item(command: 22, x: 0, y: 0, z: 10.0),
      item(command: 195, z: 0.0),
      item(command: 177, frame: 2, x: 0, y: 0, params: {1.0, 2.0, 0.0, 0.0}),
      item(command: 178, frame: 2, x: 473_977_000, y: 0, z: 0.0)
    ]

    plan = %Plan{items: still ++ [item(command: 21, z: 0.0)], fence: [{:inclusion, {:circle, {1, 2}, 5.0}}]}
    assert {:ok, moved} = Variant.offset(plan, 1, by(5, 0, 4))
    assert Enum.take(moved.items, 4) == still
    assert %{z: +0.0, y: y} = List.last(moved.items)
    assert y > 85_456_000
    assert moved.fence == plan.fence
  end

  test "the date line does not matter" do
    assert {:ok, %{items: [%{y: y}]}} =
             Variant.offset(%Plan{items: [item(x: 0, y: 1_799_999_900)]}, 1, by(10, 0, 0))

    assert y < 0 and y > -1_800_000_000
  end

  test "what an offset makes impossible names the item and what to do" do
    low = %Plan{items: [item(), item(z: 4.0)]}
    assert {:ok, _plan} = Variant.offset(low, 1, by(0, 0, -3))

    assert {:error, "item 2 would be at -2.0 m, below the ground: " <> _} =
             Variant.offset(low, 2, by(0, 0, -3))

    sea = %Plan{home: {{473_977_000, 85_456_000}, 480.0}, items: [item(frame: 0, z: 490.0)]}
    assert {:error, "item 1 would be at 470.0 m, below home" <> _} = Variant.offset(sea, 2, by(0, 0, -10))
    assert {:ok, _plan} = Variant.offset(%{sea | home: nil}, 2, by(0, 0, -10))

    pole = %Plan{items: [item(x: 890_000_000)]}
    assert {:error, "item 1 lies beyond 85.0° of latitude" <> _} = Variant.offset(pole, 1, by(1, 0, 0))

    assert {:error, "item 1 has a place in metres" <> _} =
             Variant.offset(%Plan{items: [item(frame: 1)]}, 1, by(1, 0, 0))

    assert {:ok, %Plan{items: []}} = Variant.offset(%Plan{}, 5, by(1, 0, 0))
  end

  test "a file is for the vehicle whose id, or else whose tag, its name has as a word" do
    vehicles = [{"sim-1", ["north"]}, {"sim-10", ["north"]}, {"sim-2", []}]

    assert Variant.assign(["field SIM-10.plan", "North_1.waypoints", "sim-2.plan"], vehicles) ==
             {%{
                "sim-1" => {:ok, "North_1.waypoints"},
                "sim-10" => {:ok, "field SIM-10.plan"},
                "sim-2" => {:ok, "sim-2.plan"}
              }, []}
  end

  test "what is not certain about files is said" do
    assert Variant.assign(["a.plan", "b 1.plan", "b 2.plan", "ä.plan"], [{"a", []}, {"b", []}, {"c", ["tag"]}]) ==
             {%{
                "a" => {:ok, "a.plan"},
                "b" => {:error, "b 1.plan, b 2.plan are all for it: leave one"},
                "c" => {:error, "no file's name has c or a tag of it"}
              }, ["ä.plan"]}
  end
end
