defmodule Aerie.Fleet.Missions.ComparisonTest do
  @moduledoc "Plans against each other, with what the gateway knows of their vehicles."
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Fleet.Missions.Comparison
  alias Aerie.Vehicle.Events.Journal
  alias Protocols.Mission.{Item, Plan}

  setup do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    {:ok, gateway: gateway}
  end

  # A kilometre to the north, from `east` metres (nearly) east of a place.
  defp plan(east, z \\ 30.0) do
    items =
      for x <- [470_000_000, 470_089_832],
          do: %Item{command: 16, frame: 0, x: x, y: 80_000_000 + round(east * 131.7), z: z}

    %Plan{items: items}
  end

  test "speeds are those of the parameters as they were read the last time, else usual ones, and said", c do
    :ok = Journal.commit(c.gateway, "A", %{}, [], %{"WPNAV_SPEED" => 1_000})
    :ok = Journal.commit(c.gateway, "P", %{}, [], %{"MPC_XY_CRUISE" => 4.0})
    found = Comparison.of(c.gateway, for(id <- ~w(A P X), do: {id, plan(0)}), 0)
    assert %{speed: 10.0, assumed: false} = found.vehicles["A"]
    assert %{speed: 4.0, assumed: false} = found.vehicles["P"]

    assert %{speed: 5.0, assumed: true, notes: ["its way to the first place is not compared"]} =
             found.vehicles["X"]

    assert_in_delta found.vehicles["A"].seconds, 100, 0.5
    assert_in_delta found.vehicles["P"].seconds, 250, 1
    assert_in_delta found.vehicles["X"].metres, 1_000, 2
  end

  test "the nearest pass of all and of each, where and when", c do
    plans = [{"A", plan(0)}, {"B", plan(40)}, {"C", plan(10, 34.0)}]
    assert %{nearest: pair, error: nil} = found = Comparison.of(c.gateway, plans, 0)
    assert {pair.one, pair.other} == {"A", "C"}
    assert_in_delta pair.metres, :math.sqrt(116), 0.05
    assert {lat, lon} = pair.place
    assert_in_delta lat, 47.0, 1.0e-6
    assert_in_delta lon, 8.0, 1.0e-6
    assert %{one: "B", other: "C"} = found.vehicles["B"].nearest

    # Those that start later are on the same way, but never there at the same time, until all are at its end.
    assert %{nearest: %{at_s: at_s}} = Comparison.of(c.gateway, plans, 20)
    assert at_s > 200
  end

  test "without plans, or with one, nothing is near", c do
    assert %{nearest: nil, error: nil, vehicles: none} = Comparison.of(c.gateway, [], 10)
    assert none == %{}

    assert %{nearest: nil, vehicles: %{"A" => %{nearest: nil}}} =
             Comparison.of(c.gateway, [{"A", plan(0)}], 10)

    assert %{vehicles: %{"A" => %{seconds: +0.0}}} = Comparison.of(c.gateway, [{"A", %Plan{}}], 10)
  end
end
