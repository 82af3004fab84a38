defmodule Aerie.Vehicle.Collision.OwnerTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Collision.Owner

  @second 1_000_000

  defp heard(owner, paths, seconds) do
    for(s <- seconds, path <- paths, do: {s, path})
    |> Enum.reduce(owner, fn {s, path}, owner -> Owner.seen(owner, path, round(s * @second)) end)
  end

  test "the vehicle that was heard first keeps the id, whichever side comes first" do
    owner = Owner.new() |> heard(["a"], 0..10) |> heard(["a", "b"], 11..12)

    for {ones, others} <- [{["a"], ["b"]}, {["b"], ["a"]}] do
      assert {found, ["a"], ["b"]} = Owner.decide(owner, ones, others, 12 * @second)
      assert Owner.others(found, 12 * @second) == ["b"]
      assert Owner.other?(found, "b", 12 * @second) and not Owner.other?(found, "a", 12 * @second)
      refute Owner.other?(found, "c", 12 * @second)
    end
  end

  test "two vehicles behind one path cannot be separated; a path that brings both belongs to neither" do
    owner = heard(Owner.new(), ["a", "b", "both"], 0..1)
    assert {^owner, _, _} = Owner.decide(owner, ["a"], ["a"], @second)
    assert {^owner, _, _} = Owner.decide(owner, ["a", "b"], ["b"], @second)
    {found, _, _} = Owner.decide(owner, ["a", "both"], ["b", "both"], @second)
    assert Owner.others(found, @second) == ["b"]
  end

  test "the decision holds for a minute, and while the first vehicle is heard" do
    owner = heard(Owner.new(), ["a", "b"], 0..1)
    {found, _, _} = Owner.decide(owner, ["a"], ["b"], @second)
    heard = heard(found, ["a", "b"], 2..60)
    assert Owner.others(heard, 60 * @second) == ["b"]
    assert Owner.others(heard, 61 * @second) == []
    assert found |> heard(["b"], 2..6) |> Owner.others(6 * @second) == ["b"]
    assert found |> heard(["b"], 2..7) |> Owner.others(7 * @second) == []
    alone = heard(found, ["b"], 2..20)
    # It comes back as the second one.
    back = heard(alone, ["a", "b"], 21..22)
    {back, ["b"], ["a"]} = Owner.decide(back, ["a"], ["b"], 22 * @second)
    assert Owner.others(back, 22 * @second) == ["a"]
  end

  test "a machine that stands still does not hand the id over, whichever is heard first afterwards" do
    owner = heard(Owner.new(), ["a", "b"], 0..1)
    {owner, ["a"], ["b"]} = Owner.decide(owner, ["a"], ["b"], @second)

    for still <- [2.5, 4.8, 6, 30, 50], {one, two} <- [{"a", "b"}, {"b", "a"}] do
      for owner <- [heard(owner, [one], [1 + still]), heard(owner, [one], [1 + still, 1.9 + still])] do
        assert Owner.others(owner, round((1 + still) * @second)) == ["b"]
        both = heard(owner, [two], [2 + still])
        assert Owner.others(both, round((2 + still) * @second)) == ["b"]
        # And the first one can still fall silent.
        assert both |> heard(["b"], [3, 4, 5, 6, 7, 8] |> Enum.map(&(&1 + still))) |> Owner.others(0) == []
      end
    end
  end

  test "the one that was heard first keeps the id by whichever path, and before it a link that says what it is" do
    # A second path makes of the first link's path one of a peer, which is heard after that of the second.
    owner = Owner.new() |> heard(["a"], 0..10) |> heard([{"b", 1}], [11]) |> heard([{"a", :remote}], [11.1])

    assert {owner, [{"a", :remote}], [{"b", 1}]} =
             Owner.decide(owner, [{"b", 1}], [{"a", :remote}], 12 * @second)

    assert Owner.other?(owner, {"b", 1}, 12 * @second)

    # Heard later.
    says = Owner.new() |> heard(["b"], 0..10) |> heard(["a"], 5..10) |> Owner.says("a", true)
    assert {_owner, ["a"], ["b"]} = Owner.decide(says, ["a"], ["b"], 11 * @second)
  end

  test "paths stay bounded" do
    owner = Enum.reduce(1..1_000, Owner.new(), &Owner.seen(&2, &1, &1 * @second))
    assert map_size(owner.paths) <= 32
    assert is_map_key(owner.paths, 1_000)
  end

  test "paths as text: links, and their peers where needed" do
    one = {"udp", {{10, 0, 0, 1}, 5}}
    other = {"udp", {{10, 0, 0, 1}, 6}}
    assert Owner.describe(["udp", one], [other]) == [["udp (10.0.0.1:5)"], ["udp (10.0.0.1:6)"]]
    assert Owner.describe(["udp", one], [{"b", :remote}]) == [["udp"], ["b"]]
    assert Owner.describe([], []) == [[], []]
    assert MavRouter.Routes.Collisions.text("a") == "a"
    assert MavRouter.Routes.Collisions.text({"a", :remote}) == "a"
    assert MavRouter.Routes.Collisions.text({"a", {{10, 0, 0, 1}, 5}}) == "a (10.0.0.1:5)"
    assert MavRouter.Routes.Collisions.text({"a", {{0, 0, 0, 0, 0, 0, 0, 1}, 5}}) == "a ([::1]:5)"
  end

  test "setting the clock neither ends the minute nor begins one" do
    owner = Owner.new() |> heard(["a"], 0..10) |> heard(["a", "b"], 11..12)
    {owner, ["a"], ["b"]} = Owner.decide(owner, ["a"], ["b"], 12 * @second)

    for hours <- [-1, 1] do
      step = hours * 3_600
      shifted = Owner.shifted(owner, step * @second) |> heard(["a", "b"], (13 + step)..(60 + step))
      assert Owner.other?(shifted, "b", (60 + step) * @second)
      refute Owner.other?(heard(shifted, ["a", "b"], (61 + step)..(73 + step)), "b", (73 + step) * @second)
    end
  end
end
