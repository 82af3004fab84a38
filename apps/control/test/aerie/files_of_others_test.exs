defmodule Aerie.FilesOfOthersTest do
  # Files as other programs write them, and files that are not understood, which must not be read as empty ones.
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Plan}
  alias Aerie.Control.{Missions, Params}

  @files Path.expand("../fixtures/others", __DIR__)

  defp file(name), do: File.read!(Path.join(@files, name))
  defp plan(name), do: name |> file() |> Missions.import(:any)

  describe "QGroundControl's .plan" do
    test "with a byte order mark, and with items of an older format" do
      assert {:ok, %Plan{items: [%Item{command: 16, x: 471_000_000, z: 20.0}]} = marked} = plan("bom.plan")
      assert {:ok, %Plan{items: [%Item{params: {+0.0, +0.0, +0.0, +0.0}} = old]}} = plan("old-item.plan")
      assert {old.x, old.y, old.z} == {471_000_000, 81_000_000, 20.0}
      assert Missions.import(file("bom.plan"), :plan) == {:ok, marked}
    end

    test "items of QGroundControl 3, with their parameters one by one" do
      item = %{"type" => "missionItem", "id" => 4, "command" => 16, "frame" => 3, "autoContinue" => true}

      item =
        Map.merge(item, %{
          "param1" => 2,
          "param2" => 0,
          "param3" => 0,
          "param4" => 0,
          "coordinate" => [47.1, 8.1, 20]
        })

      jump = %{item | "id" => 5, "command" => 177, "frame" => 2, "param1" => 4, "coordinate" => [0, 0, 0]}
      home = %{item | "id" => 0, "coordinate" => [47, 8, 400]}

      assert {:ok, %Plan{items: [first, second], home: {{470_000_000, 80_000_000}, 400.0}}} =
               read(%{"mission" => %{"version" => 1, "items" => [item, jump], "plannedHomePosition" => home}})

      assert %Item{params: {2.0, _, _, _}, x: 471_000_000, y: 81_000_000, z: 20.0} = first
      assert %Item{command: 177, params: {1.0, _, _, _}} = second

      assert {:error, "mission.complexItems" <> _} =
               read(%{"mission" => %{"items" => [], "complexItems" => [%{}]}})
    end

    test "an old fence is the polygon that it has" do
      assert {:ok, %Plan{items: [_], fence: [{:inclusion, {:polygon, [{471_000_000, 81_000_000}, _, _]}}]}} =
               plan("old-fence.plan")

      assert {:ok, %Plan{fence: []}} =
               read(%{"geoFence" => %{"version" => 1, "polygon" => [], "parameters" => []}})

      assert {:error, "geoFence.polygon: expected a list" <> _} = read(%{"geoFence" => %{"version" => 1}})
    end

    test "what is not understood is an error that says where" do
      assert {:error, "version: expected 1, got 99: open it in a current" <> _} = plan("version-99.plan")
      assert {:error, "mission.version: expected 1 or 2, got 9" <> _} = plan("mission-version-9.plan")

      for {sections, error} <- [
            {%{"geoFence" => %{"version" => 3, "polygons" => []}},
             "geoFence.version: expected 1 or 2, got 3"},
            {%{"geoFence" => %{"version" => nil, "polygons" => []}},
             "geoFence.version: expected 1 or 2, got null"},
            {%{"rallyPoints" => %{"version" => 7, "points" => []}},
             "rallyPoints.version: expected 1 or 2, got 7"},
            {%{"geofence" => %{"version" => 2, "polygons" => []}}, ~s("geofence": expected "geoFence")},
            {%{"GeoFences" => %{}}, ~s("GeoFences": expected "geoFence")},
            {%{"fence" => %{}}, ~s("fence": expected "geoFence")},
            {%{"rally_points" => %{}}, ~s("rally_points": expected "rallyPoints")},
            {%{"Mission" => %{}}, ~s("Mission": expected "mission")},
            {%{"geoFence" => nil}, "geoFence: expected an object, got null"},
            {%{"rallyPoints" => nil}, "rallyPoints: expected an object, got null"},
            {%{"mission" => nil}, "mission: expected an object, got null"},
            {%{"mission" => %{"version" => 2}}, "mission.items: expected a list, got null"},
            {%{"mission" => %{"item" => []}}, "mission.items: expected a list, got null"},
            {%{"rallyPoints" => %{"version" => 2}}, "rallyPoints.points: expected a list, got null"},
            {%{"rallyPoints" => %{"points" => [], "more" => []}}, "rallyPoints: expected only points"},
            {%{"geoFence" => %{"version" => 2}}, "geoFence: expected polygons or circles"},
            {%{"geoFence" => %{}}, "geoFence: expected polygons or circles"},
            {%{"geoFence" => %{"polygons" => nil}}, "geoFence.polygons: expected a list, got null"},
            {%{"geoFence" => %{"polygon" => [], "circles" => []}},
             "geoFence: expected only polygons, circles"}
          ] do
        assert {:error, text} = read(sections)
        assert String.starts_with?(text, error), text
      end
    end

    test "a section that is not in the file is none of the plan" do
      assert {:ok, plan} = plan("no-fence-key.plan")
      assert for(kind <- Missions.kinds(), do: Plan.contents(plan, kind)) == [nil, nil, nil]
    end

    defp read(sections),
      do: %{"fileType" => "Plan"} |> Map.merge(sections) |> JSON.encode!() |> Missions.import(:any)
  end

  describe ".waypoints" do
    test "with comments, a byte order mark, and numbers without a digit before or after the point" do
      assert {:ok, %Plan{home: {{471_000_000, 81_000_000}, 400.0}, items: [takeoff]} = plan} =
               plan("comment.waypoints")

      assert %Item{command: 22, z: 20.0} = takeoff
      assert plan("bom.waypoints") == {:ok, plan}
      assert {:ok, %Plan{items: [_, %Item{params: {0.5, _, _, _}, z: 50.0}]}} = plan("dot.waypoints")
      latin = String.replace(file("comment.waypoints"), "own comment", <<"gr", 0xFC, "n">>)
      assert Missions.import(latin, :any) == {:ok, plan}
    end

    test "of the version 120 have no home, and count their items from 0" do
      assert {:ok, %Plan{home: nil, items: [%Item{command: 22, z: 20.0}]}} = plan("120.waypoints")
      jump = "1\t0\t2\t177\t0\t3\t0\t0\t0\t0\t0\t1\n"

      assert {:ok, %Plan{items: [_, %Item{params: {1.0, 3.0, _, _}}]}} =
               Missions.import(file("120.waypoints") <> jump, :any)

      assert {:error, ~s(line 1: expected "QGC WPL 110" or "QGC WPL 120") <> _} =
               Missions.import("QGC WPL 100\n", :any)
    end

    test "without items are an error" do
      assert plan("header-only.waypoints") == {:error, "the file has no items after its first line"}
    end
  end

  describe "parameters" do
    test "with hexadecimal values, an equals sign, and no digit beside the point" do
      assert values("hex.param") == {[{"AAA", 255}], []}
      assert values("equals.param") == {[{"AAA", 5}, {"BBB", 6}], []}
      assert values("dot.param") == {[{"AAA", 0.5}, {"BBB", 5.0}], []}
      assert {:ok, [%{value: -16}]} = Params.parse("AAA -0x10\n")
      assert {:ok, [%{value: 5}]} = Params.parse(<<"# gr", 0xFC, "n\nAAA,5 # ", 0xB0, "\n">>)
      assert {:error, _} = Params.parse(<<"AA", 0xFC, ",5\n">>)
    end

    test "of a name that comes twice the last value counts" do
      assert {[{"AAA", 6}], ["AAA is in the lines 1, 2: the last one counts"]} = values("dup.param")
    end

    test "rows of another component are left out, those of another vehicle refused" do
      assert {[{"AAA", 1.0}], ["left out, because they are of component 154 and not of the autopilot: BBB"]} =
               values("gimbal-rows.params")

      assert {:ok, [%{name: "AAA"}]} = Params.parse(file("gimbal-rows.params"))
      assert {:error, [error]} = Params.read_file(file("other-system.params"), %{system_id: 1, component: 1})
      assert error.key == "line 1" and error.expected =~ "system id 7, not of 1"

      assert {:ok, [%{name: "BBB"}], []} =
               Params.read_file(file("other-system.params"), %{system_id: 7, component: 1})

      assert {:error, [%{key: "line 2"}]} = Params.parse("1\t1\tA\t1\t6\n2\t1\tB\t1\t6\n")
      assert {:error, [%{expected: text}]} = Params.parse("1\t154\tA\t1\t6\n")
      assert text =~ "no parameters of component 1"
      assert {:error, [%{key: "line 1"}]} = Params.parse("1\tx\tA\t1\t6\n")
    end

    defp values(name) do
      {:ok, entries, remarks} = Params.read_file(file(name), %{system_id: 1, component: 1})
      {Enum.map(entries, &{&1.name, &1.value}), remarks}
    end
  end
end
