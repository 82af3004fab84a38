defmodule Aerie.Control.Policy.FlightPath.RoomTest do
  @moduledoc "The room that vehicles take around places: what they flew outside of a fence is refused (C4)."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Mavlink.Review
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{FlightPath, Intent, Mavlink}
  alias Aerie.Control.Policy.Intent.Context
  alias Protocols.Mission.Item
  alias Aerie.Vehicle.Command
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  # 2224 m from south to north, 2282 m from west to east, with a tower in the south-west.
  @fence """
  {"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "field"},
     "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.03, 47.0], [8.03, 47.02], [8.0, 47.02]]]}},
    {"type": "Feature", "properties": {"name": "tower", "fence": "exclusion", "radius": 20},
     "geometry": {"type": "Point", "coordinates": [8.005, 47.005]}}]}
  """
  @now 1_795_339_800_000_000
  @middle {47.01, 8.015}

  defp policy(section \\ %{}) do
    {:ok, fence} = Policy.Fence.parse(@fence)
    {:ok, policy} = Policy.compile(section)
    %{policy | fence: fence}
  end

  defp context(autopilot, kind, params \\ %{}) do
    groups = %{
      position: %{lat: 47.01, lon: 8.015, alt_rel: 20.0, alt_msl: 520.0, heading: 0.0},
      home: %{lat: 47.01, lon: 8.015, alt_msl: 500.0},
      mode: %{mode: "GUIDED", armed: true, in_air: true}
    }

    source = Policy.Roles.principal(:client, "olga", :operator)
    struct!(Context.new(groups, source, @now), autopilot: autopilot, vehicle_type: kind, params: params)
  end

  # So many metres north of the southern border.
  defp north(metres), do: {47.0 + metres / 111_194.0, 8.015}

  defp reposition({lat, lon}, radius),
    do: %M.CommandInt{
      target_system: 1,
      command: MavCmd.value(:MAV_CMD_DO_REPOSITION),
      frame: 6,
      param3: radius,
      x: round(lat * 1.0e7),
      y: round(lon * 1.0e7),
      z: 20.0
    }

  defp item(name, {lat, lon}, params \\ {0.0, 0.0, 0.0, 0.0}, z \\ 20.0),
    do: %Item{
      command: MavCmd.value(:"MAV_CMD_#{name}"),
      frame: 3,
      params: params,
      x: round(lat * 1.0e7),
      y: round(lon * 1.0e7),
      z: z
    }

  defp message(message, context),
    do:
      Policy.decide(policy(), Mavlink.facts(message, Map.take(context, [:autopilot, :vehicle_type])), context)

  defp goto({lat, lon}, context) do
    {:ok, command} =
      Command.new([vehicle: "V", type: "goto", params: %{lat: lat, lon: lon, altitude: 20.0}], @now)

    Policy.decide(policy(), command, context)
  end

  # As a file, and as an item of MAVLink by itself.
  defp mission(items, context, policy \\ policy()) do
    vehicle = Map.take(context, [:autopilot, :vehicle_type])
    home = %Item{command: 16, frame: 0, x: 470_100_000, y: 80_150_000, z: 500.0}
    whole = Review.plan(policy, [home | items], 0, vehicle, context)

    single =
      for {item, seq} <- Enum.with_index(items, 1) do
        facts = Mavlink.facts(Item.message(item, seq, 0, {1, 1}), vehicle)
        Policy.decide(policy, facts, context)
      end

    {whole, Enum.find(single, :allow, &(&1 != :allow))}
  end

  test "a radius that a goto gives counts, whatever the firmware" do
    for {autopilot, kind} <- [ardupilot: "plane", px4: "plane", px4: "vtol", generic: "unknown"] do
      context = context(autopilot, kind, %{"WP_LOITER_RAD" => 60, "NAV_LOITER_RAD" => 60})
      assert {:deny, :geofence, reason} = message(reposition(north(532), 500.0), context)
      assert reason =~ "needs 780 m around it, because it circles there with a radius of 500 m"
      assert message(reposition(@middle, 500.0), context) == :allow
      assert {:deny, :geofence, _} = message(reposition(@middle, -800.0), context)
    end

    assert message(reposition(north(30), 0.0), context(:ardupilot, "copter")) == :allow
    assert message(reposition(north(30), :nan), context(:px4, "copter")) == :allow
  end

  test "a plane circles with its own radius, by every way to say goto; one that is not known is large" do
    for {autopilot, name} <- [ardupilot: "WP_LOITER_RAD", px4: "NAV_LOITER_RAD"] do
      known = context(autopilot, "plane", %{name => -60.0})
      unknown = context(autopilot, "plane")

      for ask <- [&goto/2, &message(reposition(&1, 0.0), &2), &message(reposition(&1, :nan), &2)] do
        assert {:deny, :geofence, reason} = ask.(north(86), known)
        assert reason =~ "needs 120 m around it, because it circles there with #{name}, 60 m"
        assert ask.(north(130), known) == :allow
        assert {:deny, :geofence, reason} = ask.(north(400), unknown)
        assert reason =~ "#{name}, which is not known yet and counts as 300 m"
        assert ask.(@middle, unknown) == :allow
      end
    end

    # The tower counts as the border does.
    context = context(:ardupilot, "plane", %{"WP_LOITER_RAD" => 60.0})
    assert {:deny, :geofence, reason} = goto({47.006, 8.0055}, context)
    assert reason =~ ~s(the border of the exclusion zone "tower")
  end

  test "waypoints: where it turns, and how far it flies on" do
    plane = context(:ardupilot, "plane", %{"WP_LOITER_RAD" => 60.0, "WP_RADIUS" => 90.0})
    assert {:allow, :allow} = mission([item("NAV_WAYPOINT", north(130))], plane)

    for {where, params} <- [
          {north(110), {0.0, 0.0, 0.0, 0.0}},
          # It flies on for 126 m.
          {north(200), {0.0, 0.0, 126.0, 0.0}},
          {north(200), {0.0, 250.0, 0.0, 0.0}}
        ] do
      assert {{:deny, :geofence, 1, _}, {:deny, :geofence, _}} =
               mission([item("NAV_WAYPOINT", where, params)], plane)
    end

    for {context, near} <- [
          {context(:px4, "copter", %{"NAV_ACC_RAD" => 10.0}), 12},
          {context(:ardupilot, "copter", %{"WPNAV_RADIUS" => 200.0}), 4}
        ] do
      assert {:allow, :allow} = mission([item("NAV_WAYPOINT", north(near))], context)
      assert {{:deny, :geofence, 1, _}, _} = mission([item("NAV_WAYPOINT", north(near / 3))], context)
    end

    # A copter of ArduPilot takes no notice of these parameters, one of PX4 turns early.
    far = [item("NAV_WAYPOINT", north(50), {0.0, 100.0, 100.0, 0.0})]
    assert {:allow, :allow} = mission(far, context(:ardupilot, "copter"))
    assert {{:deny, :geofence, 1, _}, _} = mission(far, context(:px4, "copter"))
  end

  test "circles, landings, take-offs and curves of a mission take their room" do
    plane = context(:ardupilot, "plane", %{"WP_LOITER_RAD" => 60.0, "WP_RADIUS" => 90.0})
    own = {0.0, 0.0, 0.0, 0.0}

    for name <- ~w(NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_LOITER_TO_ALT NAV_LAND NAV_VTOL_LAND) do
      assert {{:deny, :geofence, 1, _}, {:deny, :geofence, _}} = mission([item(name, north(100), own)], plane),
             name

      assert {:allow, :allow} = mission([item(name, north(130), own)], plane), name
    end

    # A plane climbs along its way, a copter above its place.
    assert {{:deny, :geofence, 1, _}, _} = mission([item("NAV_TAKEOFF", north(150), own, 50.0)], plane)
    assert {:allow, :allow} = mission([item("NAV_TAKEOFF", north(150), own, 50.0)], context(:px4, "copter"))

    curve = [item("NAV_WAYPOINT", {47.01, 8.003}), item("NAV_SPLINE_WAYPOINT", {47.01, 8.02})]

    assert {{:deny, :geofence, 2, reason}, _} =
             mission(Enum.map(curve, &%{&1 | x: &1.x - 80_000}), context(:ardupilot, "copter"))

    assert reason =~ "curve"
  end

  test "a landing that is aborted climbs (principle 11: without a number, as high as the firmware may)" do
    low = policy(%{max_altitude: 60})
    land = &[item("NAV_LAND", @middle, {&1, 0.0, 0.0, 0.0}, 0.0)]
    plane = context(:ardupilot, "plane")
    assert {{:deny, :altitude, 1, reason}, {:deny, :altitude, _}} = mission(land.(300.0), plane, low)
    assert reason =~ "300 m above home; at most 60 m"
    assert {:allow, :allow} = mission(land.(0.0), plane, low)
    assert {{:deny, :altitude, 1, _}, _} = mission(land.(0.0), plane, policy(%{max_altitude: 25}))
    assert {:allow, :allow} = mission(land.(300.0), context(:ardupilot, "copter"), low)

    assert {{:deny, :altitude, 1, _}, _} = mission(land.(0.0), context(:px4, "plane"), low)
    assert {:allow, :allow} = mission(land.(0.0), context(:px4, "plane", %{"MIS_LND_ABRT_ALT" => 30.0}), low)
  end

  test "what every firmware may do counts while the firmware is not known" do
    for sweep <- [{:stay, nil}, {:turns, nil}, {:pass, 0, 0}, {:land, 0}, :takeoff] do
      room =
        &FlightPath.room({nil, %{lat: 47.0, lon: 8.0, home: 50.0, msl: nil}, :home}, sweep, context(&1, &2))

      known =
        for autopilot <- [:ardupilot, :px4], kind <- ["copter", "plane", "vtol"], do: room.(autopilot, kind)

      unknown = room.(:generic, "unknown")
      assert Enum.all?(known, &(&1.metres <= unknown.metres and &1.climb <= unknown.climb)), inspect(sweep)
    end
  end

  test "each way that a jump may fly is judged, not only the ways in order" do
    copter = context(:ardupilot, "copter", %{"WPNAV_RADIUS" => 200.0})
    w = &item("NAV_WAYPOINT", &1)
    {west, north, east} = {{47.005, 8.002}, {47.009, 8.005}, {47.005, 8.008}}
    around = [w.({47.009, 8.002}), w.(west), w.({47.008, 8.002}), w.(north), w.({47.008, 8.008}), w.(east)]
    assert {:allow, _} = mission(around, copter)

    other = fn name, p1 ->
      %Item{command: MavCmd.value(:"MAV_CMD_#{name}"), frame: 2, params: {p1, -1.0, 0.0, 0.0}}
    end

    for {name, items} <- %{
          "straight" => [w.(west), w.(east)],
          "back" => around ++ [other.("DO_JUMP", 2.0)],
          "over" => [w.(north), w.(west), other.("DO_JUMP", 6.0), w.({47.009, 8.002}), w.(north), w.(east)],
          "over, past what is no place" => [
            w.(north),
            w.(west),
            other.("DO_JUMP", 6.0),
            w.({47.009, 8.002}),
            w.(north),
            other.("NAV_DELAY", 1.0),
            w.(east)
          ],
          "two in a row" => [
            w.(north),
            w.(west),
            other.("DO_JUMP", 5.0),
            w.(north),
            other.("DO_JUMP", 7.0),
            w.(north),
            w.(east)
          ],
          "to a tag" => [
            w.(north),
            w.(west),
            other.("DO_JUMP_TAG", 7.0),
            w.({47.009, 8.002}),
            w.(north),
            other.("JUMP_TAG", 7.0),
            w.(east)
          ]
        } do
      assert {{:deny, :geofence, _seq, reason}, _} = mission(items, copter), name
      assert reason =~ ~s(enters the exclusion zone "tower"), name
    end

    assert {:allow, _} = mission(around ++ [other.("DO_JUMP", 5.0)], copter)
    assert {:allow, _} = mission(around ++ [other.("DO_JUMP_TAG", 7.0), other.("JUMP_TAG", 7.0)], copter)
  end

  test "a mission of jumps only ends" do
    jump = %Item{command: 177, frame: 2, params: {1.0, -1.0, 0.0, 0.0}}
    assert {:allow, _} = mission(List.duplicate(jump, 500), context(:ardupilot, "copter"))
  end

  test "a description without a firmware takes no room, and an intent without a place neither" do
    assert FlightPath.room(
             {nil, %{lat: 47.0, lon: 8.0, home: 50.0, msl: nil}, :home},
             {:stay, nil},
             context(nil, nil)
           ).metres == 0

    assert Intent.named("hold").sweep == nil
  end
end
