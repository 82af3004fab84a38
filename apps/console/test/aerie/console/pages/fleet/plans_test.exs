defmodule Aerie.Console.Pages.Fleet.PlansTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command.Result
  alias Protocols.Mission.{Item, Plan}
  alias Aerie.Console.Pages.Fleet.Plans

  @waypoint 16
  @speed 178

  defp item(command, x \\ 0, y \\ 0),
    do: %Item{frame: 3, command: command, params: {0.0, 0.0, 0.0, nil}, x: x, y: y, z: 10.0}

  # As if a task had begun to read.
  defp reading(id) do
    ref = make_ref()
    {%Plans{shown: %{id => %{ref: ref, reading: true, plan: %Plan{}, count: 2, errors: []}}}, ref}
  end

  test "parts come one by one, and what could not be read says why" do
    {plans, ref} = reading("A")
    assert Plans.summary(plans) == ["A: reading its plans …"]
    items = [item(@waypoint, 470_000_000, 80_000_000), item(@speed), item(@waypoint, 470_010_000, 80_000_000)]
    fence = [{:exclusion, {:circle, {470_000_000, 80_000_000}, 50.0}}]

    plans =
      plans
      |> Plans.update("A", ref, {:mission, {:ok, %{plan: %Plan{items: items}}}})
      |> Plans.update("A", ref, {:fence, {:ok, %{plan: %Plan{fence: fence}}}})
      |> Plans.update("A", ref, {:rally, {:error, Result.new("x", :failed, "no rally points here")}})
      |> Plans.update("A", ref, :done)

    assert Plans.summary(plans) == ["A: rally: no rally points here"]

    # Items without a place are counted, and not drawn.
    assert [
             %{
               vehicle: "A",
               current: 3,
               mission: [[47.0, 8.0, 1], [47.001, 8.0, 3]],
               rally: [],
               fences: [zone]
             }
           ] =
             Plans.payload(plans, %{"A" => 3})

    assert zone == %{kind: :exclusion, centre: [47.0, 8.0], radius: 50.0}
  end

  test "a late answer of an earlier reading changes nothing" do
    {plans, _ref} = reading("A")
    assert Plans.update(plans, "A", make_ref(), :done) == plans
    assert Plans.update(plans, "B", make_ref(), :done) == plans
  end

  test "what is gone is forgotten; another number of items is read again, the same is not" do
    {plans, ref} = reading("A")
    gateway = make_ref()
    assert Plans.keep(plans, gateway, %{}).shown == %{}
    plans = Plans.update(plans, "A", ref, :done)
    assert Plans.keep(plans, gateway, %{"A" => 2}) == plans

    assert %{shown: %{"A" => %{reading: true, count: 5, ref: again}}} =
             Plans.keep(plans, gateway, %{"A" => 5})

    assert again != ref
  end

  test "only so many vehicles are read" do
    gateway = make_ref()
    ids = for n <- 1..(Plans.most() + 5), do: "V#{n}"
    plans = Plans.toggle(%Plans{}, gateway, ids, %{})
    assert map_size(plans.shown) == Plans.most()
    assert Plans.toggle(plans, gateway, Enum.take(ids, 3), %{}).shown |> map_size() == Plans.most() - 3
  end
end
