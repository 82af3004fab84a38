defmodule Aerie.Control.Policy.Mavlink.ReviewTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Mavlink.Review
  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Firmware
  alias Aerie.Control.Policy.Intent.Context

  @vehicle %{autopilot: :px4, vehicle_type: "copter"}

  # A square of 0.02 degrees with a notch: the way from its one arm to the other leaves it.
  defp policy(section \\ %{}) do
    ring = [
      [8.0, 47.0],
      [8.02, 47.0],
      [8.02, 47.02],
      [8.012, 47.02],
      [8.012, 47.005],
      [8.008, 47.005],
      [8.008, 47.02],
      [8.0, 47.02],
      [8.0, 47.0]
    ]

    feature = %{
      "type" => "Feature",
      "properties" => %{"name" => "field"},
      "geometry" => %{"type" => "Polygon", "coordinates" => [ring]}
    }

    {:ok, fence} = Policy.Fence.parse(JSON.encode!(%{"type" => "FeatureCollection", "features" => [feature]}))
    {:ok, policy} = Policy.compile(section)
    %{policy | fence: fence}
  end

  defp context(fields \\ %{}) do
    source = %{name: "olga", role: :admin, permissions: Policy.Roles.own()}
    groups = %{home: %{lat: 47.003, lon: 8.004, alt_msl: 400.0}}
    struct!(Context.new(groups, source, 1_000_000), fields)
  end

  defp at(lat, lon, alt \\ 20.0, fields \\ []) do
    struct!(%Item{command: 16, frame: 3, x: round(lat * 1.0e7), y: round(lon * 1.0e7), z: alt}, fields)
  end

  defp review(items, policy \\ policy(), context \\ context(), type \\ 0, vehicle \\ @vehicle),
    do: Review.plan(policy, items, type, vehicle, context)

  test "a mission inside is allowed, around the notch" do
    takeoff = at(47.01, 8.004, 20.0, command: 22)
    assert review([takeoff | around()] ++ [at(47.003, 8.015), %Item{command: 20, frame: 2}]) == :allow

    # 0, 0 is where it is to ArduPilot, and a place to PX4.
    here = %Item{command: 22, frame: 3, x: 0, y: 0, z: 20.0}
    assert {:deny, :geofence, 0, _reason} = review([here | around()])
    ardupilot = %{@vehicle | autopilot: :ardupilot}
    assert review([at(47.01, 8.004), here | around()], policy(), context(), 0, ardupilot) == :allow
  end

  defp around, do: [at(47.01, 8.004), at(47.003, 8.004), at(47.003, 8.016), at(47.01, 8.016)]

  test "the first item outside is named, and the first way that leaves" do
    assert {:deny, :geofence, 1, reason} = review([at(47.01, 8.004), at(47.03, 8.004)])
    assert reason =~ "mission item 1" and reason =~ "outside the zone \"field\""

    assert {:deny, :geofence, 1, reason} = review([at(47.01, 8.004), at(47.01, 8.016)])
    assert reason =~ "the straight way to mission item 1" and reason =~ "leaves the zone"
  end

  test "the way home, a jump and a circle are ways too" do
    assert {:deny, :geofence, 4, reason} = review(around() ++ [%Item{command: 20, frame: 2}])
    assert reason =~ "home (mission item 4)"

    jump = fn target -> %Item{command: 177, frame: 2, params: {target, 2.0, 0.0, 0.0}} end
    assert {:deny, :geofence, 4, _reason} = review(around() ++ [jump.(0.0)])
    assert review(around() ++ [jump.(2.0)]) == :allow

    loiter = at(47.01, 8.004, 20.0, command: 18, params: {2.0, 0.0, 500.0, 0.0})
    assert {:deny, :geofence, 0, reason} = review([loiter])
    assert reason =~ "mission item 0" and reason =~ "needs 500 m around it, because it circles there"
  end

  test "items are judged by what their commands need and lead to, as when a ground station sends them" do
    operator = context(%{source: %{name: "olga", role: :operator, permissions: []}})
    denied = policy(%{max_altitude: 50, modes: %{denied: ["ACRO"]}})
    operator = %{operator | autopilot: :px4, vehicle_type: "copter"}
    nowhere = &%Item{command: &1, frame: 2, params: &2}
    far = &at(47.5, 8.004, 20.0, command: &1)

    for {rule, item} <- [
          role: nowhere.(208, {2.0, 0.0, 0.0, 0.0}),
          number: nowhere.(208, {2.3, 0.0, 0.0, 0.0}),
          role: nowhere.(185, {1.0, 0.0, 0.0, 0.0}),
          role: nowhere.(218, {31.0, 2.0, 0.0, 0.0}),
          role: nowhere.(207, {0.0, 0.0, 0.0, 0.0}),
          role: nowhere.(180, {7.0, 0.0, 0.0, 0.0}),
          role: nowhere.(42_702, {0.0, 0.0, 0.0, 0.0}),
          unknown: nowhere.(43_999, {0.0, 0.0, 0.0, 0.0}),
          mode: nowhere.(176, {1.0, 5.0, 0.0, 0.0}),
          altitude: %Item{command: 30, frame: 3, z: 500.0},
          altitude: %Item{command: 113, frame: 3, z: 500.0},
          altitude: nowhere.(186, {500.0, 3.0, 0.0, 0.0}),
          altitude: at(47.01, 8.004, 500.0, command: 31),
          # A home that moves in flight.
          role: at(47.01, 8.004, 20.0, command: 179),
          geofence: far.(22),
          geofence: far.(84),
          geofence: far.(189),
          geofence: far.(192),
          geofence: at(47.01, 8.004, 20.0, command: 34, params: {500.0, 0.0, 0.0, 0.0})
        ] do
      found = review([at(47.01, 8.004), item], denied, operator)
      assert match?({:deny, ^rule, 1, _reason}, found), inspect({item, found})
    end

    admin = %{operator | source: %{name: "ada", role: :admin, permissions: []}}
    # A parachute is a part of plans that people fly; the end of a flight is not.
    for p1 <- [0.0, 1.0, 2.0],
        do: assert(review([at(47.01, 8.004), nowhere.(208, {p1, 0.0, 0.0, 0.0})], denied, admin) == :allow)

    assert {:deny, :role, 1, _} =
             review([at(47.01, 8.004), nowhere.(185, {1.0, 0.0, 0.0, 0.0})], denied, admin)

    home = at(47.01, 8.004, 500.0, command: 179)
    assert {:deny, :altitude, 1, _reason} = review([at(47.01, 8.004), home], denied, admin)

    # Nothing tells where it is, and its height counts nevertheless.
    lost = %{operator | home: nil}
    assert {:deny, :altitude, 0, _reason} = review([%Item{command: 30, frame: 3, z: 500.0}], denied, lost)

    assert review([at(47.01, 8.004), %Item{command: 30, frame: 3, z: 40.0}], denied, operator) == :allow
    assert review([], denied, operator, 2) == :allow
    assert {:deny, :role, nil, reason} = review([], denied, operator, 1)
    assert reason =~ "protection"
  end

  test "heights" do
    policy = policy(%{max_altitude: 50.0, min_altitude: 5.0})
    assert review([at(47.01, 8.004, 49.0), at(47.01, 8.005, 0.0, command: 21)], policy) == :allow
    assert {:deny, :altitude, 1, reason} = review([at(47.01, 8.004, 49.0), at(47.01, 8.005, 51.0)], policy)
    assert reason == "mission item 1 is 51 m above home; at most 50 m is allowed"
    # Above mean sea level, with home's height.
    assert review([at(47.01, 8.004, 449.0, frame: 0)], policy) == :allow
    assert {:deny, :altitude, 0, _} = review([at(47.01, 8.004, 451.0, frame: 0)], policy)
    # Above the ground: how high that is, nobody knows.
    assert {:deny, :altitude, 0, _} = review([at(47.01, 8.004, 20.0, frame: 10)], policy)
  end

  test "refuses a source that may not send missions before any item" do
    viewer = %{name: "guest", role: :viewer, permissions: []}
    assert {:deny, :role, nil, _reason} = review([at(47.03, 8.004)], policy(), context(%{source: viewer}))
  end

  test "ArduPilot's home is not a place to fly to" do
    plan = %Plan{home: {{100_000_000, 100_000_000}, 0.0}, items: [at(47.01, 8.004)]}
    vehicle = %{@vehicle | autopilot: :ardupilot}
    items = Onboard.items(plan, 0, Firmware.Ardupilot.Adapter)
    assert review(items, policy(), context(), 0, vehicle) == :allow
    assert {:deny, :geofence, 0, _reason} = review(items)
  end

  test "a fence may not reach beyond the policy's, rally points must be inside" do
    inside =
      {:inclusion,
       {:polygon, [{470_010_000, 80_010_000}, {470_010_000, 80_020_000}, {470_020_000, 80_010_000}]}}

    outside = {:inclusion, {:circle, {471_010_000, 80_010_000}, 50.0}}
    items = fn zones -> Onboard.items(%Plan{fence: zones}, 1, Firmware.Px4.Adapter) end
    assert review(items.([inside]), policy(), context(), 1) == :allow
    assert {:deny, :geofence, 3, _reason} = review(items.([inside, outside]), policy(), context(), 1)
    assert review(items.([put_elem(outside, 0, :exclusion)]), policy(), context(), 1) == :allow

    rally = fn places -> Onboard.items(%Plan{rally: places}, 2, Firmware.Px4.Adapter) end
    assert review(rally.([{{470_010_000, 80_010_000}, 20.0}]), policy(), context(), 2) == :allow

    assert {:deny, :geofence, 0, _} =
             review(rally.([{{471_010_000, 80_010_000}, 20.0}]), policy(), context(), 2)
  end
end
