defmodule Aerie.Control.Mission.OwnFenceTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Mission.OwnFence
  alias Protocols.Mission.{Item, Plan}

  @copter %{
    autopilot: :ardupilot,
    vehicle_type: "copter",
    place: nil,
    home: nil,
    flying?: false,
    fenced?: false
  }
  @px4 %{@copter | autopilot: :px4}

  # Metres from 47, 8.
  defp at(east, north), do: {470_000_000 + round(north * 89.832), 80_000_000 + round(east * 89.832 / 0.6820)}
  defp degrees(east, north), do: then(at(east, north), fn {lat, lon} -> {lat / 1.0e7, lon / 1.0e7} end)

  defp square(east, north, side),
    do:
      {:polygon,
       [at(east, north), at(east + side, north), at(east + side, north + side), at(east, north + side)]}

  defp waypoint(east, north, fields \\ []) do
    {x, y} = at(east, north)
    struct!(%Item{command: 16, frame: 3, x: x, y: y, z: 20.0}, fields)
  end

  defp texts(plan, vehicle \\ @copter), do: for(finding <- OwnFence.check(plan, vehicle), do: finding.text)

  test "waypoints, rally points and the return point are judged by the plan's fence" do
    plan = %Plan{
      fence: [{:inclusion, square(0, 0, 100)}, {:exclusion, {:circle, at(20, 20), 10.0}}],
      fence_return: {at(-50, 0), 30.0},
      items: [waypoint(50, 50), waypoint(150, 50), waypoint(22, 22), waypoint(90, 90)],
      rally: [{at(10, 90), 20.0}, {at(10, 190), 20.0}]
    }

    assert [
             %{
               part: :mission,
               index: 1,
               text: "item 2 is outside the plan's stay-inside zone 1",
               breach?: false
             },
             %{part: :mission, index: 2, text: "item 3 is in the plan's keep-out zone 2"},
             %{part: :rally, index: 1, text: "rally point 2 is outside" <> _},
             %{part: :fence, index: nil, text: "the return point is outside" <> _}
           ] = findings = OwnFence.check(plan, @copter)

    assert length(OwnFence.remarks(findings, :fence)) == 4
    assert length(OwnFence.remarks(findings, :mission)) == 2
    assert ["rally point 2" <> _] = OwnFence.remarks(findings, :rally)
    assert texts(%{plan | fence: [], items: plan.items}) == []
  end

  test "the ways between the items are judged, by all zones and exactly" do
    through = fn fence, items, vehicle -> texts(%Plan{fence: fence, items: items}, vehicle) end

    ring =
      {:polygon,
       [
         at(0, 0),
         at(300, 0),
         at(300, 300),
         at(200, 300),
         at(200, 100),
         at(100, 100),
         at(100, 300),
         at(0, 300)
       ]}

    ends = [waypoint(50, 250), waypoint(250, 250)]

    assert through.([{:inclusion, ring}], ends, @copter) ==
             ["the way to item 2 goes outside the plan's stay-inside zone 1"]

    around = [waypoint(50, 250), waypoint(50, 50), waypoint(250, 50), waypoint(250, 250)]
    assert through.([{:inclusion, ring}], around, @copter) == []
    thin = {:exclusion, {:polygon, [at(150, -500), at(150.5, -500), at(150.5, 500), at(150, 500)]}}
    assert through.([thin], ends, @copter) == ["the way to item 2 goes through the plan's keep-out zone 1"]
    circle = fn east, radius -> {:exclusion, {:circle, at(east, 250), radius}} end

    assert through.([circle.(150, 5.0)], ends, @copter) == [
             "the way to item 2 goes through the plan's keep-out zone 1"
           ]

    assert through.([{:exclusion, {:circle, at(150, 260), 9.0}}, circle.(400, 50.0)], ends, @copter) == []
    # Two zones that overlap: PX4 may fly from one to the other, ArduPilot has to be in both.
    both = [{:inclusion, square(0, 200, 160)}, {:inclusion, square(140, 200, 160)}]
    assert through.(both, ends, @px4) == []
    gap = [{:inclusion, square(0, 200, 100)}, {:inclusion, square(200, 200, 100)}]
    assert ["the way to item 2 goes outside the plan's stay-inside zones 1, 2"] = through.(gap, ends, @px4)
    # A leg of no length, and one along a border.
    assert through.([thin], [waypoint(50, 250), waypoint(50, 250)], @copter) == []
    assert is_list(through.([{:inclusion, square(0, 0, 100)}], [waypoint(0, 0), waypoint(0, 100)], @copter))
  end

  test "the ways of jumps, from home and home are judged" do
    wall = [{:exclusion, square(100, 0, 10)}]
    jump = fn to -> %Item{command: 177, frame: 2, params: {to / 1, -1.0, 0.0, 0.0}} end
    rtl = %Item{command: 20, frame: 2}
    {west, east, over} = {waypoint(50, 5), waypoint(150, 5), waypoint(100, 300)}
    found = fn items, vehicle -> texts(%Plan{fence: wall, items: items}, vehicle) end
    through = "goes through the plan's keep-out zone 1"

    # Around the wall, and back through it by the jump.
    assert found.([west, over, east, jump.(1)], @copter) == [
             "the way to item 1 by the jump of item 4 #{through}"
           ]

    assert [%{part: :mission, index: 0, outside?: true}] =
             OwnFence.check(%Plan{fence: wall, items: [west, over, east, jump.(1)]}, @copter)

    # One to the way that is flown anyway is told once; those to nowhere and to themselves end.
    assert found.([west, east, jump.(2)], @copter) == ["the way to item 2 #{through}"]
    assert found.([west, jump.(2), jump.(99), jump.(-3)], @copter) == []
    tag = %Item{command: 600, frame: 2, params: {7.0, 0.0, 0.0, 0.0}}

    assert found.([tag, west, over, east, %{tag | command: 601}], @copter) == [
             "the way to item 2 by the jump of item 5 #{through}"
           ]

    at_home = %{@copter | home: degrees(0, 5)}
    assert found.([east, over, west], at_home) == ["the way to item 1 from home #{through}"]
    assert found.([west, over, east, rtl], at_home) == ["the way home (item 4) #{through}"]
    assert found.([west, rtl], at_home) == []
    # A take-off without a place is at home; the plan's home counts while the vehicle's is not known.
    up = %Item{command: 22, frame: 3, x: 0, y: 0, z: 20.0}
    assert found.([up, east], at_home) == ["the way to item 2 from home #{through}"]
    plan = %Plan{fence: wall, items: [up, east, over, west], home: {at(0, 5), 400.0}}
    assert texts(plan) == ["the way to item 2 from home #{through}"]
    assert texts(plan, %{@copter | home: degrees(150, 50)}) == []
    # Home itself is no item, so a home that is outside is told by the ways to and from it.
    assert texts(%Plan{fence: [{:inclusion, square(40, 0, 400)}], items: [west, rtl]}, at_home) == [
             "the way to item 1 from home goes outside the plan's stay-inside zone 1",
             "the way home (item 2) goes outside the plan's stay-inside zone 1"
           ]
  end

  test "for any way and zones, a place on the way that is wrong is found" do
    place = {:proper_types.integer(-200, 200), :proper_types.integer(-200, 200)}

    zone =
      {:proper_types.oneof([:inclusion, :exclusion]), :proper_types.list(place), place,
       :proper_types.integer(1, 150)}

    property =
      :proper.forall({:proper_types.non_empty(:proper_types.list(zone)), place, place}, fn {zones, {x1, y1},
                                                                                            {x2, y2}} ->
        fence =
          for {kind, corners, {x, y}, radius} <- zones do
            if length(corners) > 2,
              do: {kind, {:polygon, for({e, n} <- corners, do: at(e + 0.3, n + 0.4))}},
              else: {kind, {:circle, at(x, y), radius / 1}}
          end

        wrong? = fn share ->
          {e, n} = {x1 + share * (x2 - x1), y1 + share * (y2 - y1)}
          Enum.any?(texts(%Plan{fence: fence, items: [waypoint(e, n)]}, @px4), &(&1 =~ "item 1"))
        end

        ways =
          for "the way" <> _ <- texts(%Plan{fence: fence, items: [waypoint(x1, y1), waypoint(x2, y2)]}, @px4),
              do: :found

        sampled? = Enum.any?(1..99, &wrong?.(&1 / 100))
        # A finding may be between two samples; a sample that is wrong has to be found.
        wrong?.(0) or wrong?.(1) or ways != [] or not sampled?
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true, inspect(:proper.counterexample())
  end

  test "only what a vehicle flies to is judged" do
    items = [
      waypoint(500, 500, command: 201),
      %Item{command: 22, frame: 3, x: 0, y: 0, z: 20.0},
      %Item{command: 178, frame: 2, params: {1.0, 5.0, -1.0, 0.0}},
      waypoint(500, 500, frame: 1)
    ]

    assert texts(%Plan{fence: [{:inclusion, square(0, 0, 100)}], items: items}) == []
  end

  test "ArduPilot wants a vehicle inside all stay-inside zones, PX4 inside one" do
    apart = %Plan{fence: [{:inclusion, square(0, 0, 100)}, {:inclusion, {:circle, at(300, 50), 100.0}}]}
    assert ["stay-inside zones 1 and 2 have no place in common" <> _] = texts(apart)
    assert texts(apart, @px4) == []

    overlapping = %{
      apart
      | fence: [{:inclusion, square(0, 0, 100)}, {:inclusion, square(50, 50, 100)}],
        items: [waypoint(10, 10)]
    }

    assert texts(overlapping) == ["item 1 is outside the plan's stay-inside zone 2"]
    assert texts(overlapping, @px4) == []

    assert ["item 1 is outside the plan's stay-inside zones 1, 2"] =
             texts(%{overlapping | items: [waypoint(-10, -10)]}, @px4)
  end

  test "zones that touch, cross or hold each other have places in common" do
    for {one, two, apart?} <- [
          {square(0, 0, 100), square(10, 10, 10), false},
          {{:polygon, [at(40, -100), at(60, -100), at(60, 100), at(40, 100)]},
           {:polygon, [at(-100, 0), at(200, 0), at(200, -10), at(-100, -10)]}, false},
          {square(0, 0, 100), {:circle, at(50, 50), 5.0}, false},
          {square(0, 0, 100), {:circle, at(110, 50), 15.0}, false},
          {square(0, 0, 100), {:circle, at(110, 50), 5.0}, true},
          {{:circle, at(0, 0), 50.0}, {:circle, at(90, 0), 50.0}, false},
          {{:circle, at(0, 0), 50.0}, {:circle, at(110, 0), 50.0}, true},
          # The second lies in the first one's notch.
          {{:polygon, [at(0, 0), at(100, 0), at(100, 100), at(60, 100), at(50, 10), at(40, 100), at(0, 100)]},
           {:polygon, [at(49, 60), at(51, 60), at(50, 90)]}, true}
        ],
        fence <- [[one, two], [two, one]] do
      found = texts(%Plan{fence: Enum.map(fence, &{:inclusion, &1})})
      assert found != [] == apart?, inspect({fence, found})
    end
  end

  test "names a vehicle outside, and one that flies with its fence on breaches it at once" do
    plan = %Plan{fence: [{:inclusion, square(0, 0, 100)}]}
    outside = %{@copter | place: degrees(200, 50)}

    assert [
             %{
               part: :fence,
               breach?: false,
               text: "the vehicle is outside the plan's stay-inside zone 1" <> _
             }
           ] =
             OwnFence.check(plan, outside)

    assert [%{breach?: true}] = OwnFence.check(plan, %{outside | flying?: true, fenced?: true})
    assert [%{breach?: false}] = OwnFence.check(plan, %{outside | flying?: true})
    assert [%{breach?: false}] = OwnFence.check(plan, %{outside | fenced?: true})
    assert texts(plan, %{@copter | place: degrees(50, 50)}) == []

    # Inside one of two: whether that is a breach depends on an option.
    two = %Plan{fence: plan.fence ++ [{:inclusion, square(-100, 0, 200)}]}
    inside_one = %{outside | place: degrees(-50, 50), flying?: true, fenced?: true}
    assert [%{breach?: false}] = OwnFence.check(two, inside_one)
    assert OwnFence.check(two, %{inside_one | autopilot: :px4}) == []
  end

  test "across the antimeridian" do
    fence = [
      {:inclusion,
       {:polygon,
        [{0, 1_799_990_000}, {0, -1_799_990_000}, {10_000, -1_799_990_000}, {10_000, 1_799_990_000}]}}
    ]

    inside = %Item{command: 16, frame: 3, x: 5_000, y: -1_799_995_000, z: 20.0}
    assert texts(%Plan{fence: fence, items: [inside]}) == []
    assert [_outside] = texts(%Plan{fence: fence, items: [%{inside | y: -1_799_900_000}]})
  end

  test "a plan of thousands of corners and items is not judged for minutes" do
    ring = for n <- 1..2_000, do: at(1000 * :math.cos(n / 318.3), 1000 * :math.sin(n / 318.3))
    plan = %Plan{fence: [{:inclusion, {:polygon, ring}}], items: List.duplicate(waypoint(5_000, 0), 2_000)}

    assert ["the plan is too large to be checked" <> _, "the vehicle is outside" <> _] =
             texts(plan, %{@copter | place: degrees(5_000, 0)})
  end

  test "what is known of a vehicle" do
    now = 1_000_000_000
    group = &%{data: &1, at: now}

    snapshot = %Aerie.Vehicle.Snapshot{
      autopilot: :px4,
      vehicle_type: "copter",
      groups: %{
        position: group.(%{lat: 47.0, lon: 8.0}),
        mode: group.(%{in_air: true, armed: true}),
        health: group.(%{fence_enabled: true}),
        home: group.(%{lat: 47.1, lon: 8.1, alt_msl: 400.0})
      }
    }

    assert OwnFence.vehicle(snapshot, now) ==
             %{
               autopilot: :px4,
               vehicle_type: "copter",
               place: {47.0, 8.0},
               home: {47.1, 8.1},
               flying?: true,
               fenced?: true
             }

    # Where it was a minute ago tells nothing.
    assert %{place: nil} = OwnFence.vehicle(snapshot, now + 60_000_000)
    assert %{place: nil, flying?: false, fenced?: false} = OwnFence.vehicle(%{snapshot | groups: %{}}, now)
    assert %{place: nil, home: nil} = OwnFence.vehicle(nil, now)
  end
end
