defmodule Protocols.Mission.PlanTest do
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Protocols.Mission.File.{QgcPlan, Waypoints}
  alias Aerie.Vehicle.Firmware

  # As QGroundControl writes it: a take-off, a survey, a jump back, a fence of each kind, two rally points.
  @qgc """
  {"fileType": "Plan", "version": 1, "groundStation": "QGroundControl",
   "mission": {"version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5,
    "globalPlanAltitudeMode": 1, "plannedHomePosition": [47.397742, 8.545594, 488.2],
    "items": [
     {"type": "SimpleItem", "AMSLAltAboveTerrain": null, "Altitude": 50, "AltitudeMode": 1, "autoContinue": true, "command": 22,
      "doJumpId": 1, "frame": 3, "params": [0, 0, 0, null, 47.397742, 8.545594, 50]},
     {"type": "ComplexItem", "complexItemType": "survey", "version": 5, "angle": 0, "polygon": [[47.4, 8.5]],
      "TransectStyleComplexItem": {"version": 2, "CameraCalc": {}, "VisualTransectPoints": [[47.398, 8.546]],
       "Items": [
        {"type": "SimpleItem", "autoContinue": true, "command": 16, "doJumpId": 2, "frame": 3,
         "params": [0, 0, 0, null, 47.398, 8.546, 50]},
        {"type": "SimpleItem", "autoContinue": true, "command": 206, "doJumpId": 3, "frame": 2,
         "params": [25, 0, 1, 0, 0, 0, 0]}]}},
     {"type": "SimpleItem", "autoContinue": false, "command": 177, "doJumpId": 9, "frame": 2, "params": [2, 3, 0, 0, 0, 0, 0]}]},
   "geoFence": {"version": 2,
    "polygons": [{"inclusion": true, "version": 1, "polygon": [[47.39, 8.54], [47.39, 8.55], [47.40, 8.55]]}],
    "circles": [{"inclusion": false, "version": 1, "circle": {"center": [47.395, 8.545], "radius": 30.5}}],
    "breachReturn": [47.396, 8.546, 40]},
   "rallyPoints": {"version": 2, "points": [[47.397, 8.546, 20], [47.398, 8.547, 25]]}}
  """

  defp edit(path, value) do
    {:ok, json} = JSON.decode(@qgc)
    JSON.encode!(put_in(json, Enum.map(path, &if(is_integer(&1), do: Access.at(&1), else: &1)), value))
  end

  describe "QGroundControl's .plan" do
    test "mission with the items of a survey, fence, rally points" do
      assert {:ok, plan} = QgcPlan.read(@qgc)
      assert plan.home == {{473_977_420, 85_455_940}, 488.2}

      assert [takeoff, transect, trigger, jump] = plan.items

      assert %Item{
               command: 22,
               frame: 3,
               params: {+0.0, +0.0, +0.0, nil},
               x: 473_977_420,
               y: 85_455_940,
               z: 50.0
             } = takeoff

      assert %Item{command: 16, x: 473_980_000} = transect
      assert %Item{command: 206, frame: 2, params: {25.0, +0.0, 1.0, +0.0}, x: 0, y: 0} = trigger
      # By its number, not by its id.
      assert %Item{command: 177, params: {2.0, 3.0, +0.0, +0.0}, autocontinue: 0} = jump

      assert [
               {:inclusion, {:polygon, [{473_900_000, 85_400_000}, _, _]}},
               {:exclusion, {:circle, {473_950_000, 85_450_000}, 30.5}}
             ] =
               plan.fence

      assert plan.fence_return == {{473_960_000, 85_460_000}, 40.0}
      assert plan.rally == [{{473_970_000, 85_460_000}, 20.0}, {{473_980_000, 85_470_000}, 25.0}]
    end

    test "what is written is read again" do
      {:ok, plan} = QgcPlan.read(@qgc)
      assert QgcPlan.read(QgcPlan.write(plan)) == {:ok, plan}
      assert QgcPlan.read(QgcPlan.write(%Plan{})) == {:ok, %Plan{}}
    end

    test "errors say where" do
      items = ["mission", "items"]

      for {path, value, error} <- [
            {items ++ [0, "params"], [0, 0, 0, 0, 95, 8, 1],
             "mission.items[0] param5: expected degrees from -90 to 90, got 95"},
            {items ++ [0, "params"], [0, 0, 0],
             "mission.items[0].params: expected seven numbers, got [0, 0, 0]"},
            {items ++ [0, "params"], ["x", 0, 0, 0, 0, 0, 0],
             "mission.items[0] param1: expected a number, got \"x\""},
            {items ++ [0, "command"], 70_000,
             "mission.items[0] command: expected a whole number from 0 to 65535, got 70000"},
            {items ++ [0, "type"], "Other",
             "mission.items[0].type: expected \"SimpleItem\" or \"ComplexItem\", got \"Other\""},
            {items ++ [1, "TransectStyleComplexItem", "Items", 1, "params"], [0, 0, 0, 0, 0.5, 0, 0],
             "mission.items[1].TransectStyleComplexItem.Items[1] param5: expected a whole number, because the frame is MISSION, got 0.5"},
            {items ++ [1, "TransectStyleComplexItem"], %{},
             "mission.items[1]: expected the items of the ComplexItem in the file, got \"survey\""},
            {items ++ [2, "params"], [7, 3, 0, 0, 0, 0, 0],
             "mission.items[2].params[0]: expected the doJumpId of an item, got 7.0"},
            {["geoFence", "polygons", 0, "polygon"], [[1, 2], [3, 4]],
             "geoFence.polygons[0].polygon: expected three corners or more, got 2"},
            {["geoFence", "circles", 0, "circle", "radius"], 0,
             "geoFence.circles[0].circle.radius: expected metres above 0, got 0.0"},
            {["rallyPoints", "points", 1], [1, 200],
             "rallyPoints.points[1] longitude: expected degrees from -180 to 180, got 200"},
            {["rallyPoints", "points"], Enum.map(1..501, fn _ -> [1, 2, 3] end),
             "rallyPoints.points: 501 entries; at most 500 are read"},
            {["rallyPoints", "points", 1], [1, 20],
             "rallyPoints.points[1] altitude: expected a number, got null"},
            {["rallyPoints", "points", 1], [1, 20, nil],
             "rallyPoints.points[1] altitude: expected a number, got null"},
            {["rallyPoints", "others"], [%{"type" => "SimpleItem", "command" => 5100, "index" => -1}],
             "rallyPoints.others[0].params: expected seven numbers, got null"},
            {["geoFence", "breachReturn"], [1, 20, nil],
             "geoFence.breachReturn altitude: expected a number, got null"},
            {["geoFence", "others"], nil, "geoFence.others: expected a list, got null"},
            {["fileType"], "Other", "fileType: expected \"Plan\": this is not a plan of QGroundControl"}
          ] do
        assert QgcPlan.read(edit(path, value)) == {:error, error}
      end

      assert {:error, "this is not JSON" <> _} = QgcPlan.read("{")
      assert {:error, "this is not JSON" <> _} = QgcPlan.read("<plan>")

      assert {:error, "the file is larger than 4 MiB"} =
               QgcPlan.read(String.duplicate(" ", 4 * 1024 * 1024 + 1))
    end
  end

  describe ".waypoints" do
    @wpl "QGC WPL 110\r\n0\t1\t0\t16\t0\t0\t0\t0\t-35.363261\t149.165230\t584\t1\r\n" <>
           "1\t0\t3\t22\t0.00000000\t0.0\t0\tnan\t0\t0\t20.0\t1\r\n2\t0\t3\t16\t0\t0\t0\t0\t-35.3629\t149.1652\t25.5\t1\r\n"

    test "the first line is home" do
      assert {:ok, %Plan{home: {{-353_632_610, 1_491_652_300}, 584.0}, items: [takeoff, there]}} =
               Waypoints.read(@wpl)

      assert %Item{command: 22, frame: 3, params: {+0.0, +0.0, +0.0, nil}, z: 20.0} = takeoff
      assert %Item{command: 16, x: -353_629_000, y: 1_491_652_000, z: 25.5} = there
    end

    test "what is written is read again" do
      {:ok, plan} = Waypoints.read(@wpl)
      assert Waypoints.read(Waypoints.write(plan)) == {:ok, plan}
    end

    test "numbers may have gaps; items count by their order, and so do the targets of jumps" do
      [header, home, one, two, _end] = String.split(@wpl, "\r\n")
      jump = "9\t0\t3\t177\t2\t1\t0\t0\t0\t0\t0\t1"
      renumbered = String.replace_prefix(two, "2", "7")
      assert {:ok, plan} = Waypoints.read(Enum.join([header, home, one, renumbered, jump], "\n"))
      assert {:ok, %{items: items}} = Waypoints.read(@wpl)
      assert [_one, _two, %Item{command: 177, params: {2.0, 1.0, _, _}}] = plan.items
      assert Enum.take(plan.items, 2) == items

      for {lines, error} <- [
            {[home, renumbered, one], "line 4: expected an item after 7, got 1"},
            {[home, one, one], "line 4: expected an item after 1, got 1"},
            {[home, String.replace_prefix(one, "1", "1.5")], "line 3: expected an item after 0, got 1.5"}
          ],
          do: assert(Waypoints.read(Enum.join([header | lines], "\n")) == {:error, error})
    end

    test "errors say in which line" do
      for {text, error} <- [
            {"", ~s(the file is empty; it must begin with "QGC WPL 110" or "QGC WPL 120")},
            {"QGC WPL 130\n", ~s(line 1: expected "QGC WPL 110" or "QGC WPL 120", got "QGC WPL 130")},
            {"QGC WPL 110\n\n0 1 0\n", "line 3: expected 12 columns, got 3"},
            {"QGC WPL 110\n5\t1\t0\t16\t0\t0\t0\t0\t1\t1\t584\t1\n", "line 2: expected item 0, got 5"},
            {"QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\tx\t1\t1\t584\t1\n",
             "line 2 column 8: expected a number, got \"x\""},
            {"QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t91\t1\t584\t1\n",
             "line 2 param5: expected degrees from -90 to 90, got 91"}
          ] do
        assert Waypoints.read(text) == {:error, error}
      end

      assert {:error, "the file is not text" <> _} = Waypoints.read(<<255, 254>>)
    end
  end

  describe "on board" do
    test "ArduPilot's item 0 is home, and PX4 counts a jump's target from 0" do
      {:ok, plan} = QgcPlan.read(@qgc)

      assert [home, _takeoff, _transect, _trigger, jump] = Onboard.items(plan, 0, Firmware.Ardupilot.Adapter)
      assert %Item{command: 16, frame: 0, x: 473_977_420, z: 488.2} = home
      assert {2.0, 3.0, _, _} = jump.params

      assert [%Item{command: 22}, _transect, _trigger, jump] = Onboard.items(plan, 0, Firmware.Px4.Adapter)
      assert {1.0, 3.0, _, _} = jump.params
    end

    test "what is stored is the plan again" do
      {:ok, plan} = QgcPlan.read(@qgc)

      for protocol <- [Firmware.Ardupilot.Adapter, Firmware.Px4.Adapter] do
        stored =
          Enum.reduce(0..2, %Plan{home: plan.home}, fn type, stored ->
            Onboard.put(stored, type, Onboard.items(plan, type, protocol), protocol)
          end)

        assert stored == plan
      end

      assert Onboard.items(%Plan{}, 0, Firmware.Ardupilot.Adapter) == []
    end

    @corner %Item{command: 5001, frame: 0, params: {4.0, 0.0, 0.0, 0.0}, x: 473_900_000, y: 85_400_000}
    @around_home %Item{@corner | command: 5005, params: {300.0, 0.0, 0.0, 0.0}}
    @keep_out %Item{@corner | command: 5004, params: {25.0, 0.0, 0.0, 0.0}}

    defp reread(plan) do
      assert {:ok, read} = plan |> QgcPlan.write() |> QgcPlan.read()
      read
    end

    # As newer ArduPilot has it: a circle around home among others.
    test "the rest of a fence is read, and what a file has no place for stands beside it and is named" do
      square =
        for {dx, dy} <- [{0, 0}, {1, 0}, {1, 1}, {0, 1}],
            do: %{@corner | x: @corner.x + dx, y: @corner.y + dy}

      items = square ++ [@around_home, @keep_out]
      plan = Onboard.put(%Plan{}, 1, items, Firmware.Ardupilot.Adapter)
      assert [{:inclusion, {:polygon, [_, _, _, _]}}, {:exclusion, {:circle, _, 25.0}}] = plan.fence
      assert plan.fence_others == [@around_home]
      assert Plan.contents(plan, :fence) == "4 corners and 1 circle and 1 other item"

      assert [remark] = Plan.remarks(plan, :fence)

      assert remark =~
               "an item has the command NAV_FENCE_HOME_CIRCLE_INCLUSION and the frame GLOBAL: this is under"

      assert reread(plan) == plan
      assert Enum.sort(Onboard.items(reread(plan), 1, Firmware.Ardupilot.Adapter)) == Enum.sort(items)
      refute Plan.empty?(Onboard.put(%Plan{}, 1, [@around_home], Firmware.Ardupilot.Adapter), :fence)
    end

    test "whatever a vehicle has in a fence is there again after a file" do
      back = %{@corner | command: 5000, params: {0.0, 0.0, 0.0, 0.0}}

      for items <- [
            # Not complete, of another command, without a place or a radius, a second return point, one above the sea.
            [@corner, @corner],
            [%{@corner | params: {3.0, 0.0, 0.0, 0.0}}, @keep_out],
            [%{@corner | command: 16}],
            [%{@corner | params: {nil, 0.0, 0.0, 0.0}}],
            [%{@keep_out | x: nil, y: nil}],
            [%{@keep_out | params: {nil, 0.0, 0.0, 0.0}}],
            [%{@keep_out | params: {0.0, 0.0, 0.0, 0.0}}],
            [back, back],
            [%{back | z: 500.0}]
          ] do
        plan = Onboard.put(%Plan{}, 1, [@keep_out | items], Firmware.Px4.Adapter)
        assert [{:exclusion, {:circle, _, 25.0}} | _] = plan.fence
        assert [_ | _] = plan.fence_others
        assert length(Plan.remarks(plan, :fence)) == length(plan.fence_others)
        assert reread(plan) == plan
        assert length(Onboard.items(plan, 1, Firmware.Px4.Adapter)) == 1 + length(items)
      end

      many = List.duplicate(%{@corner | command: 16}, 30)
      assert length(Plan.remarks(Onboard.put(%Plan{}, 1, many, Firmware.Px4.Adapter), :fence)) == 21
    end

    test "the height of a rally point keeps its frame, by a file as well" do
      point = fn frame, z -> %Item{command: 5100, frame: frame, x: 473_950_000, y: 85_450_000, z: z} end

      items = [
        point.(0, 560.0),
        point.(3, 40.0),
        point.(10, 30.0),
        point.(5, 1.0),
        point.(6, 2.0),
        point.(11, 3.0)
      ]

      plan = Onboard.put(%Plan{}, 2, items, Firmware.Ardupilot.Adapter)

      assert Enum.map(plan.rally, &elem(&1, 1)) == [{560.0, 0}, 40.0, {30.0, 10}, {1.0, 0}, 2.0, {3.0, 10}]
      assert reread(plan) == plan

      assert for(item <- Onboard.items(reread(plan), 2, Firmware.Ardupilot.Adapter), do: {item.frame, item.z}) ==
               [{0, 560.0}, {3, 40.0}, {10, 30.0}, {0, 1.0}, {3, 2.0}, {10, 3.0}]

      # QGroundControl reads what is above home, and no height as another one.
      assert {:ok, %{"rallyPoints" => %{"points" => [[_, _, 40.0], [_, _, 2.0]]}}} =
               JSON.decode(QgcPlan.write(plan))

      assert [
               "rally point 1 is 560.0 m above mean sea level: " <> _,
               "rally point 3 is 30.0 m above the ground: " <> _ | _
             ] =
               Plan.remarks(plan, :rally)

      odd = [point.(2, 5.0), point.(1, 5.0), point.(3, nil), %{point.(3, 5.0) | x: nil}, @corner]
      plan = Onboard.put(plan, 2, [point.(3, 7.0) | odd], Firmware.Ardupilot.Adapter)
      assert [{_place, 7.0}] = plan.rally
      assert plan.rally_others == odd
      assert reread(plan) == plan
    end

    test "a place has to have a height, whatever the frame" do
      {:ok, plan} =
        "../../fixtures/heightless/terrain-null.plan"
        |> Path.expand(__DIR__)
        |> File.read!()
        |> QgcPlan.read()

      assert Enum.map(plan.items, &Item.height?/1) == [true, false, false]
      for frame <- [0, 2, 3, 5, 6, 10, 11], do: refute(Item.height?(%Item{command: 16, frame: frame, z: nil}))
      # Without a place the last parameter may be unset; a command that nobody knows has one if it is given.
      assert Item.height?(%Item{command: 2000, frame: 2, z: nil})
      refute Item.height?(%Item{command: 65_000, frame: 3, z: nil})
      assert Item.height?(%Item{command: 65_000, frame: 3, x: nil, y: nil, z: nil})
    end

    test "a digest is of what the items say" do
      {:ok, plan} = QgcPlan.read(@qgc)
      digest = Plan.digest(plan.items)
      assert digest =~ ~r/^[0-9a-f]{64}$/
      [first | rest] = plan.items
      assert Plan.digest([%{first | frame: 6, z: 50 + 1.0e-9} | rest]) == digest
      assert Plan.digest([%{first | z: 50.1} | rest]) != digest
      assert Plan.digest([%{first | params: {0.0, 0.0, 0.0, 0.0}} | rest]) != digest
    end
  end

  test "whatever a file holds, reading it gives a plan or an error" do
    json =
      :proper_types.oneof([
        :proper_types.integer(),
        :proper_types.float(),
        :proper_types.list(:proper_types.integer()),
        nil,
        true,
        %{},
        "text"
      ])

    paths =
      for path <- [
            ["mission"],
            ["mission", "items"],
            ["mission", "plannedHomePosition"],
            ["mission", "items", 0],
            ["mission", "items", 0, "params"],
            ["mission", "items", 0, "command"],
            ["mission", "items", 1, "TransectStyleComplexItem"],
            ["mission", "items", 1, "TransectStyleComplexItem", "Items"],
            ["geoFence"],
            ["geoFence", "polygons", 0],
            ["geoFence", "polygons", 0, "polygon"],
            ["geoFence", "circles", 0, "circle"],
            ["geoFence", "breachReturn"],
            ["geoFence", "others"],
            ["rallyPoints", "others"],
            ["rallyPoints", "points"],
            ["rallyPoints", "points", 0]
          ],
          do: path

    property =
      :proper.forall({:proper_types.oneof(paths), json}, fn {path, value} ->
        case QgcPlan.read(edit(path, value)) do
          {:ok, plan} -> QgcPlan.read(QgcPlan.write(plan)) == {:ok, plan}
          {:error, text} -> is_binary(text)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 400]) == true, inspect(:proper.counterexample())

    line =
      :proper_types.list(
        :proper_types.oneof(["0", "1", "16", "3", "1e400", "-1.5", "nan", "x", "\t", "\n", " ", "1e", "."])
      )

    property =
      :proper.forall(line, fn parts ->
        case Waypoints.read("QGC WPL 110\n" <> Enum.join(parts, "\t")) do
          {:ok, %Plan{}} -> true
          {:error, text} -> is_binary(text)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 400]) == true, inspect(:proper.counterexample())
  end
end
