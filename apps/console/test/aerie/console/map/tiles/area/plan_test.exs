defmodule Aerie.Console.Map.Tiles.Area.PlanTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Map.Tiles.Area.Plan

  @field %{west: 8.5, south: 47.3, east: 8.6, north: 47.4}

  defp plan(box, zooms, most \\ 1_000_000) do
    {:ok, plan} = Plan.new(box, zooms, most)
    plan
  end

  test "the tiles of a box, from the first zoom to the last" do
    assert %{total: 1} = whole = plan(%{west: -180, south: -85, east: 180, north: 85}, 0..0)
    assert Plan.tile(whole, 0) == {0, 0, 0}
    assert %{total: 5} = plan(%{west: -180, south: -85, east: 180, north: 85}, 0..1)

    # Zürich, as OpenStreetMap's servers number it.
    assert %{total: 5} = one = plan(%{west: 8.5403, south: 47.3779, east: 8.5404, north: 47.378}, 10..14)
    assert Plan.tile(one, 0) == {10, 536, 358}
    assert Plan.tile(one, 4) == {14, 8580, 5737}
  end

  test "a box that is reversed, is too large, or lies on both sides of 180° is refused" do
    for odd <- [%{@field | west: 9}, %{@field | north: 47.3}, %{@field | east: 190}, %{@field | north: 89}],
        do: assert({:error, "the area must lie" <> _} = Plan.new(odd, 0..5, 1))

    assert {:error, words} = Plan.new(%{@field | east: 20, north: 60}, 0..20, 1)
    assert words =~ "at most 50000"
  end

  test "two at a time; one that fails is asked for again later, and many in a row end it" do
    {plan, actions} = Plan.handle(plan(@field, 12..14), :begin)
    assert actions == [{:fetch, 0}, {:fetch, 1}]
    assert {plan, [{:fetch, 2}]} = Plan.handle(plan, {:fetched, 0, {:ok, 10}})
    assert {plan, [{:wait, ms, 2}]} = Plan.handle(plan, {:fetched, 2, {:error, "no"}})
    assert ms > 0
    assert {plan, [{:fetch, 2}]} = Plan.handle(plan, {:again, 2})

    failed =
      Enum.reduce(1..30, plan, fn _n, plan ->
        plan |> Plan.handle({:fetched, 2, {:error, "no"}}) |> elem(0)
      end)

    assert failed.ended == "no"
    assert {^failed, []} = Plan.handle(failed, {:again, 2})
    assert {%{ended: "cancelled"}, []} = Plan.handle(plan, {:cancel, "cancelled"})

    assert {%{ended: "the gateway's room" <> _}, []} =
             Plan.handle(%{plan | most: 50}, {:fetched, 1, {:ok, 100}})
  end

  test "however the answers come, each tile is fetched once, and then it is done" do
    property =
      :proper.forall(:proper_types.list(:proper_types.boolean()), fn answers ->
        plan = plan(@field, 10..14)
        {plan, fetched} = run(Plan.handle(plan, :begin), answers, [])
        plan.ended == :done and Enum.sort(fetched) == Enum.to_list(0..(plan.total - 1))
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 50}]) == true, inspect(:proper.counterexample())
  end

  # Fails as often as told, but never so often in a row that it ends.
  defp run({plan, []}, _answers, fetched), do: {plan, fetched}

  defp run({plan, [{:wait, _ms, number} | more]}, answers, fetched),
    do: run(join(Plan.handle(plan, {:again, number}), more), answers, fetched)

  defp run({plan, [{:fetch, number} | more]}, [false | answers], fetched) when plan.failures < 5,
    do: run(join(Plan.handle(plan, {:fetched, number, {:error, "no"}}), more), answers, fetched)

  defp run({plan, [{:fetch, number} | more]}, answers, fetched),
    do:
      run(join(Plan.handle(plan, {:fetched, number, {:ok, 1}}), more), Enum.drop(answers, 1), [
        number | fetched
      ])

  defp join({plan, actions}, more), do: {plan, more ++ actions}
end
