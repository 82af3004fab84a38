defmodule Aerie.Vehicle.RivalsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Rivals

  @second 1_000_000

  defp heard(rivals, ways, seconds) do
    for(s <- seconds, way <- ways, do: {s, way})
    |> Enum.reduce(rivals, fn {s, way}, rivals -> Rivals.heard(rivals, way, round(s * @second)) end)
  end

  test "who was there first keeps the id, whichever side the sign names first" do
    rivals = Rivals.new() |> heard(["a"], 0..10) |> heard(["a", "b"], 11..12)

    for {ones, others} <- [{["a"], ["b"]}, {["b"], ["a"]}] do
      assert {found, ["a"], ["b"]} = Rivals.found(rivals, ones, others, 12 * @second)
      assert Rivals.others(found, 12 * @second) == ["b"]
      assert Rivals.other?(found, "b", 12 * @second) and not Rivals.other?(found, "a", 12 * @second)
      refute Rivals.other?(found, "c", 12 * @second)
    end
  end

  test "two behind one way cannot be taken apart; a way that brings both is nobody's" do
    rivals = heard(Rivals.new(), ["a", "b", "both"], 0..1)
    assert {^rivals, _, _} = Rivals.found(rivals, ["a"], ["a"], @second)
    assert {^rivals, _, _} = Rivals.found(rivals, ["a", "b"], ["b"], @second)
    {found, _, _} = Rivals.found(rivals, ["a", "both"], ["b", "both"], @second)
    assert Rivals.others(found, @second) == ["b"]
  end

  test "it holds for a minute, and as long as the first one is heard" do
    rivals = heard(Rivals.new(), ["a", "b"], 0..1)
    {found, _, _} = Rivals.found(rivals, ["a"], ["b"], @second)
    heard = heard(found, ["a", "b"], 2..60)
    assert Rivals.others(heard, 60 * @second) == ["b"]
    assert Rivals.others(heard, 61 * @second) == []
    alone = heard(found, ["b"], 2..20)
    assert Rivals.others(alone, 6 * @second) == ["b"]
    assert Rivals.others(alone, 7 * @second) == []
    # It comes back, and is the second one now.
    back = heard(alone, ["a", "b"], 21..22)
    {back, ["b"], ["a"]} = Rivals.found(back, ["a"], ["b"], 22 * @second)
    assert Rivals.others(back, 22 * @second) == ["a"]
  end

  test "ways stay bounded" do
    rivals = Enum.reduce(1..1_000, Rivals.new(), &Rivals.heard(&2, &1, &1 * @second))
    assert map_size(rivals.ways) <= 32
    assert is_map_key(rivals.ways, 1_000)
  end

  test "in words" do
    one = {"udp", {{10, 0, 0, 1}, 5}}
    other = {"udp", {{10, 0, 0, 1}, 6}}
    assert Rivals.words(["udp", one], [other]) == [["udp (10.0.0.1:5)"], ["udp (10.0.0.1:6)"]]
    assert Rivals.words(["udp", one], [{"b", :remote}]) == [["udp"], ["b"]]
    assert Rivals.words([], []) == [[], []]
    assert Aerie.Router.Apart.text("a") == "a"
    assert Aerie.Router.Apart.text({"a", :remote}) == "a"
    assert Aerie.Router.Apart.text({"a", {{10, 0, 0, 1}, 5}}) == "a (10.0.0.1:5)"
    assert Aerie.Router.Apart.text({"a", {{0, 0, 0, 0, 0, 0, 0, 1}, 5}}) == "a ([::1]:5)"
  end

  test "a clock that is set ends no minute and begins none" do
    rivals = Rivals.new() |> heard(["a"], 0..10) |> heard(["a", "b"], 11..12)
    {rivals, ["a"], ["b"]} = Rivals.found(rivals, ["a"], ["b"], 12 * @second)

    for hours <- [-1, 1] do
      step = hours * 3_600
      shifted = Rivals.shifted(rivals, step * @second) |> heard(["a", "b"], (13 + step)..(60 + step))
      assert Rivals.other?(shifted, "b", (60 + step) * @second)
      refute Rivals.other?(heard(shifted, ["a", "b"], (61 + step)..(73 + step)), "b", (73 + step) * @second)
    end
  end
end
