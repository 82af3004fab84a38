defmodule Aerie.Fleet.Missions.CourseTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Missions.Course
  alias Protocols.Mission.{Item, Plan}

  @origin {47.0, 8.0}
  @flying %{
    id: "V",
    place: @origin,
    up: 10.0,
    home_m: 400.0,
    speed: 5.0,
    climb: 2.0,
    descent: 1.0,
    circles?: false
  }

  # Metres from the origin.
  defp item(east, north, fields \\ []) do
    {lat, lon} = Course.degrees({east, north}, @origin)
    struct!(%Item{command: 16, frame: 3, x: round(lat * 1.0e7), y: round(lon * 1.0e7), z: 10.0}, fields)
  end

  defp course(items, vehicle \\ @flying), do: Course.of(%Plan{items: items}, vehicle, @origin)

  defp near!(points, expected) do
    assert length(points) == length(expected), inspect(points)

    for {one, two} <- Enum.zip(points, expected),
        {a, b} <- Enum.zip(Tuple.to_list(one), Tuple.to_list(two)),
        do: assert_in_delta(a, b, 0.05)
  end

  test "a vehicle in the air begins where it is, and climbs and descends no faster than it can" do
    course = course([item(50, 0), item(50, 0, z: 30.0), item(50, 10, z: 10.0)])

    near!(course.points, [
      {0, 0, 0, 410},
      {10, 50, 0, 410},
      {20, 50, 0, 430},
      {40, 50, 10, 410}
    ])

    assert course.until == :stays and course.notes == [] and course.heights?
    assert_in_delta Course.seconds(course), 40, 0.1
    assert_in_delta course.metres, 60, 0.1
  end

  test "the plan's speed, holds, delays and jumps count" do
    speed = %Item{command: 178, frame: 2, params: {1.0, 10.0, -1.0, 0.0}}
    delay = %Item{command: 93, frame: 2, params: {7.0, -1.0, -1.0, -1.0}}
    back = %Item{command: 177, frame: 2, params: {2.0, 1.0, 0.0, 0.0}}
    hold = {3.0, 0.0, 0.0, nil}

    near!(course([speed, item(100, 0, params: hold), item(0, 0), back, delay]).points, [
      {0, 0, 0, 410},
      {10, 100, 0, 410},
      {13, 100, 0, 410},
      {23, 0, 0, 410},
      {33, 100, 0, 410},
      {36, 100, 0, 410},
      {46, 0, 0, 410},
      {53, 0, 0, 410}
    ])
  end

  test "one on the ground begins at its place if its plan takes off, else at the first place of its plan" do
    ground = %{@flying | up: nil}
    takeoff = %Item{command: 22, frame: 3, x: 0, y: 0, z: 20.0}

    course = course([takeoff, item(50, 0, z: 20.0), item(50, 0, command: 21, z: 0.0)], ground)
    near!(course.points, [{0, 0, 0, 400}, {10, 0, 0, 420}, {20, 50, 0, 420}, {40, 50, 0, 400}])
    assert course.until == :ends and course.notes == []

    assert %{points: [{+0.0, _x, _y, 410.0}], notes: ["its way to the first place is not compared"]} =
             course([item(50, 0)], ground)
  end

  test "what a plan does not say ends the course, with a note" do
    home = %Item{command: 20, frame: 2}

    for {items, end_s, note} <- [
          {[item(50, 0), home, item(100, 0)], 10,
           "item 2 flies home by the vehicle's own settings: not compared from there on"},
          {[%Item{command: 93, frame: 2, params: {-1.0, 12.0, 0.0, 0.0}}], 0,
           "item 1 waits for a time of day" <> ": not compared from there on"},
          {[item(50, 0, command: 94)], 10,
           "item 1 (NAV_PAYLOAD_PLACE) takes a time that the plan does not say: not compared from there on"},
          {[item(60_000, 0)], 0, "item 1 lies more than 50 km away: not compared from there on"}
        ] do
      course = course(items)
      assert course.until == :ends
      assert course.notes == [note]
      assert_in_delta Course.seconds(course), end_s, 0.1
    end

    assert %{until: :stays, notes: ["item 1 stays until somebody commands it"]} =
             course([item(5, 0, command: 17)])

    assert %{notes: ["item 1 is flown in a curve" <> _]} = course([item(5, 0, command: 82)])

    assert %{notes: ["item 1 is flown in a circle" <> _]} =
             course([item(5, 0, command: 19)], %{@flying | circles?: true})
  end

  test "a loop for ever ends at the limit" do
    for loop <- [{1.0, -1.0, 0.0, 0.0}, {2.0, -1.0, 0.0, 0.0}, {1.0e9, 1.0, 0.0, 0.0}, {nil, 1.0, 0.0, 0.0}] do
      course = course([item(50, 0), item(0, 0), %Item{command: 177, frame: 2, params: loop}])
      assert length(course.points) <= 2_000
    end

    assert %{until: :ends, notes: ["item 1 comes after more ways" <> _]} =
             course([%Item{command: 177, frame: 2, params: {1.0, -1.0, 0.0, 0.0}}])
  end

  test "heights above the ground, and above a home that is not known, are not heights above the sea" do
    assert %{heights?: false, notes: ["item 1 has a height above the ground" <> _]} =
             course([item(5, 0, frame: 10)])

    assert %{heights?: false} = course([item(5, 0)], %{@flying | home_m: nil})
    assert %{heights?: true, points: [_, {_, _, _, 500.0}]} = course([item(5, 0, frame: 0, z: 500.0)])
  end

  test "a plan without places is where its vehicle is, or nowhere" do
    assert %{points: [{+0.0, _, _, 410.0}], until: :stays} = course([])
    assert %{points: []} = course([], %{@flying | up: nil})
  end
end
