defmodule Aerie.Console.Pages.Plan.DraftTest do
  use ExUnit.Case, async: true

  alias Protocols.Mission.Plan
  alias Aerie.Console.Pages.Plan.{Draft, Edit, Kinds, Profile}

  @place {47.397742, 8.545594}

  defp added(draft, what \\ 16, place \\ @place, altitude \\ 30.0) do
    {:ok, draft} = Draft.add(draft, place, what, altitude)
    draft
  end

  defp jump(draft, to) do
    {:ok, draft} = Draft.add_action(%{draft | picked: nil}, 177)
    {:ok, draft} = Draft.set_item(draft, length(draft.plan.items) - 1, %{params: {to / 1, 1.0, 0.0, 0.0}})
    draft
  end

  defp commands(draft), do: Enum.map(draft.plan.items, & &1.command)

  describe "a mission" do
    test "grows behind the picked item, or at the end" do
      draft = %Draft{} |> added(22) |> added(16) |> added(21)
      assert commands(draft) == [22, 16, 21]
      assert draft |> Draft.pick({0, nil}) |> added(82) |> commands() == [22, 82, 16, 21]
      assert [%{frame: 3, x: 473_977_420, y: 85_455_940, z: 30.0} | _] = draft.plan.items
    end

    test "a jump goes on leading to its item when items come, go and change places" do
      draft = %Draft{} |> added(22) |> added(16) |> added(21) |> jump(2)

      target = fn draft ->
        draft.plan.items |> Enum.find(&(&1.command == 177)) |> then(&elem(&1.params, 0))
      end

      {:ok, inserted} = Draft.insert(draft, {:mission, 0, nil}, @place)
      assert target.(inserted) == 3.0
      {:ok, removed} = Draft.remove(draft, {:mission, 0, nil})
      assert target.(removed) == 1.0
      {:ok, shifted} = Draft.shift(draft, 1, 1)
      assert commands(shifted) == [22, 21, 16, 177]
      assert target.(shifted) == 3.0
      assert {:ok, ^draft} = Draft.shift(draft, 0, -1)
    end

    test "an inserted item is as high as the one before it" do
      draft = %Draft{} |> added(22, @place, 55.0) |> added(16)
      {:ok, draft} = Draft.insert(draft, {:mission, 1, nil}, @place)
      assert Enum.map(draft.plan.items, & &1.z) == [55.0, 55.0, 30.0]
    end

    test "an item that becomes one without a position loses it, and a picture has its shutter" do
      form = %{"part" => "mission", "index" => "0", "lat" => "47.397742", "lon" => "8.545594"}
      {:ok, draft} = %Draft{} |> added() |> Edit.set(Map.put(form, "command", "20"))
      assert [%{command: 20, x: 0, y: 0}] = draft.plan.items
      {:ok, draft} = Edit.set(draft, Map.put(form, "command", "203"))
      assert [%{command: 203, x: 1, y: 0}] = draft.plan.items
      {:ok, draft} = Edit.set(added(%Draft{}), Map.put(form, "command", "203"))
      assert [%{command: 203, x: 1, y: 0}] = draft.plan.items
      {:ok, draft} = Edit.set(draft, Map.put(form, "command", "16"))
      assert [%{command: 16}] = draft.plan.items
    end

    test "a rally point keeps what its height is measured from, and a part that is cleared has nothing left" do
      other = %Protocols.Mission.Item{command: 5005, frame: 0}
      place = {473_977_420, 85_455_940}
      plan = %Plan{home: {place, 488.0}, rally: [{place, {560.0, 0}}, {place, 30.0}], fence_others: [other]}
      draft = Draft.part(%Draft{plan: plan}, :rally)
      {:ok, draft} = Draft.set_rally(draft, 0, 570)
      {:ok, draft} = Draft.set_rally(draft, 1, 40)
      {:ok, draft} = Draft.move(draft, {:rally, 0, nil}, {47.0, 8.0})
      assert [{{470_000_000, 80_000_000}, {570.0, 0}}, {^place, 40.0}] = draft.plan.rally
      {:ok, draft} = draft |> Draft.part(:fence) |> Draft.clear()
      assert draft.plan.fence_others == [] and draft.plan.home == plan.home
    end

    test "what cannot be is refused" do
      draft = added(%Draft{})
      assert {:error, "there is no such item"} = Draft.remove(draft, {:mission, 1, nil})
      assert {:error, "expected a latitude" <> _} = Draft.move(draft, {:mission, 0, nil}, {91.0, 0.0})
      assert {:error, "expected a latitude" <> _} = Draft.add(draft, {nil, 0.0}, 16, 10.0)
      assert {:error, "expected numbers" <> _} = Draft.set_item(draft, 0, %{z: 1.0e39})
      assert {:error, "the plan has no home"} = Draft.move(draft, {:home, 0, nil}, @place)
    end
  end

  describe "a fence" do
    setup do
      %{
        draft: %Draft{} |> Draft.part(:fence) |> zone(4) |> added({:exclusion, :circle})
      }
    end

    defp corners(draft, n),
      do:
        Enum.reduce(
          1..n,
          draft,
          &added(&2, {:inclusion, :polygon}, {47.0 + rem(&1, 2) / 100, 8.0 + div(&1, 2) / 100})
        )

    defp zone(draft, n) do
      {:ok, draft} = draft |> corners(n) |> Draft.close(:inclusion)
      draft
    end

    test "a polygon is drawn corner by corner, and the same place twice is one corner" do
      draft = %Draft{} |> Draft.part(:fence) |> corners(2)
      assert {[], [_, _]} = {draft.plan.fence, draft.corners}
      assert {:error, "a zone has at least three corners"} = Draft.close(draft, :exclusion)

      draft =
        draft |> added({:inclusion, :polygon}, {46.0, 7.0}) |> added({:inclusion, :polygon}, {46.0, 7.0})

      assert [_, _, {460_000_000, 70_000_000}] = draft.corners
      # Undo takes one after the other back, and then what was there before.
      assert [_, _] = Draft.undo(draft).corners
      assert Draft.drop(draft, :all).corners == []
      assert {:ok, %{corners: []}} = Draft.clear(draft)
      assert Draft.replace(draft, draft.plan).corners == []
      {:ok, closed} = Draft.close(draft, :exclusion)
      assert [{:exclusion, {:polygon, corners}}] = closed.plan.fence
      assert {corners, closed.corners} == {draft.corners, []}
      assert Draft.undo(closed).plan.fence == []
      full = corners(%{draft | corners: []}, 200)

      assert {:error, "a plan has at most 200 corners in a zone"} =
               Draft.add(full, {1.0, 1.0}, {:inclusion, :polygon}, 0.0)
    end

    test "a circle begins around the place", %{draft: draft} do
      assert [
               {:inclusion, {:polygon, [_, _, _, _]}},
               {:exclusion, {:circle, {473_977_420, 85_455_940}, 100.0}}
             ] =
               draft.plan.fence
    end

    test "corners are moved, inserted and removed, but three stay", %{draft: draft} do
      {:ok, draft} = Draft.move(draft, {:fence, 0, 2}, {47.0, 8.0})
      {:ok, draft} = Draft.insert(draft, {:fence, 0, 3}, {47.1, 8.1})

      assert [{_, {:polygon, [_, _, {470_000_000, 80_000_000}, {471_000_000, 81_000_000}, _]}} | _] =
               draft.plan.fence

      {:ok, draft} = Draft.remove(draft, {:fence, 0, 0})
      {:ok, draft} = Draft.remove(draft, {:fence, 0, 0})
      assert {:error, "a polygon has at least three" <> _} = Draft.remove(draft, {:fence, 0, 0})
      {:ok, draft} = Draft.remove(draft, {:fence, 0, nil})
      assert [{:exclusion, {:circle, _, _}}] = draft.plan.fence
    end

    test "a circle is moved by its centre and widened by its border", %{draft: draft} do
      {:ok, draft} = Draft.move(draft, {:fence, 1, 0}, {47.0, 8.0})
      {:ok, draft} = Draft.move(draft, {:fence, 1, 1}, {47.0, 8.01})
      assert [_, {:exclusion, {:circle, {470_000_000, 80_000_000}, radius}}] = draft.plan.fence
      assert_in_delta radius, 758.0, 3.0
      assert {:error, "a circle has no corners"} = Draft.insert(draft, {:fence, 1, 0}, {47.0, 8.0})
      assert {:error, "radius: " <> _} = Draft.set_zone(draft, 1, %{radius: 0})
    end
  end

  describe "undo" do
    test "any changes can be undone to the beginning and done again" do
      place = {:proper_types.float(-91.0, 91.0), :proper_types.float(-181.0, 181.0)}
      index = :proper_types.range(0, 5)
      part = :proper_types.oneof([:mission, :fence, :rally])
      what = :proper_types.oneof([:add, :move, :insert, :remove, :shift, :clear, :part, :pick, :close])

      property =
        :proper.forall(:proper_types.list({what, part, index, index, place}), fn steps ->
          draft = Enum.reduce(steps, %Draft{}, &step/2)
          changes = length(draft.undo)
          first = Enum.reduce(1..100//1, draft, fn _n, draft -> Draft.undo(draft) end)
          last = Enum.reduce(1..100//1, first, fn _n, draft -> Draft.redo(draft) end)

          first.undo == [] and length(first.redo) == changes and last.plan == draft.plan and
            (changes >= 100 or first.plan == %Plan{})
        end)

      assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true,
             inspect(:proper.counterexample())
    end

    test "a change that changes nothing is not a step" do
      draft = added(%Draft{})
      {:ok, same} = Draft.move(draft, {:mission, 0, nil}, @place)
      assert length(same.undo) == 1
      refute Draft.replace(draft, %Plan{}).changed?
      assert draft |> Draft.replace(%Plan{}) |> Draft.undo() |> Map.fetch!(:plan) == draft.plan
    end
  end

  describe "the height profile" do
    test "is over the way, above home" do
      draft =
        %Draft{} |> added(22, {47.0, 8.0}, 20.0) |> added(20, {0.0, 0.0}) |> added(16, {47.009, 8.0}, 50.0)

      assert [%{index: 0, metres: +0.0, height: 20.0}, %{index: 2, metres: metres, height: 50.0}] =
               Profile.points(draft.plan)

      assert_in_delta metres, 1001.0, 2.0

      assert %{low: +0.0, high: 50.0, line: "0.0,60.0 400.0,0.0"} =
               Profile.drawing(Profile.points(draft.plan), 400, 100)
    end

    test "a height above the sea needs home's" do
      {:ok, draft} = %Draft{} |> added() |> Draft.set_item(0, %{frame: 0, z: 500.0})
      assert [%{height: nil}] = Profile.points(draft.plan)
      {:ok, draft} = Draft.set_home(draft, @place, 480.0)
      assert [%{height: 20.0}] = Profile.points(draft.plan)
      assert Profile.drawing(Profile.points(draft.plan), 400, 100) == nil
    end
  end

  test "only kinds that are offered are taken from a page" do
    assert Kinds.parse("16") == {:ok, 16}
    assert Kinds.parse("99999") == :error
    assert Kinds.parse(nil) == :error
    assert Kinds.name(99_999) == "MAV_CMD 99999"
  end

  defp step({:part, part, _, _, _}, draft), do: Draft.part(draft, part)
  defp step({:pick, _, index, corner, _}, draft), do: Draft.pick(draft, {index, corner})

  defp step({what, part, index, corner, place}, draft) do
    result =
      case what do
        :add when draft.part == :mission ->
          Draft.add(draft, place, 16, 30.0)

        :add when draft.part == :fence ->
          Draft.add(draft, place, {:inclusion, if(index > 2, do: :circle, else: :polygon)}, 0.0)

        :add ->
          Draft.add(draft, place, nil, 20.0)

        :move ->
          Draft.move(draft, {part, index, corner}, place)

        :insert when part == :rally ->
          {:ok, draft}

        :insert ->
          Draft.insert(draft, {part, index, corner}, place)

        :remove ->
          Draft.remove(draft, {part, index, corner})

        :shift ->
          Draft.shift(draft, index, if(corner > 2, do: 1, else: -1))

        :clear ->
          Draft.clear(draft)

        :close ->
          Draft.close(draft, :exclusion)
      end

    case result do
      {:ok, draft} -> draft
      {:error, text} when is_binary(text) -> draft
    end
  end
end
