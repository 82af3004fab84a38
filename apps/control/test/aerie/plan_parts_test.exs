defmodule Aerie.PlanPartsTest do
  # What of a plan is sent, and what is never removed by the way.
  use Aerie.TransferCase, async: true

  alias Aerie.Control.{Commands, Missions, Params}
  alias Protocols.Mission.{Item, Plan}

  @moduletag :tmp_dir
  @moduletag :capture_log

  @files Path.expand("../fixtures/others", __DIR__)
  @home {-353_632_610, 1_491_652_300}

  defp near(north, east), do: {elem(@home, 0) + north * 90, elem(@home, 1) + east * 110}

  defp waypoint(north, east) do
    {x, y} = near(north, east)
    %Item{command: 16, frame: 3, params: {0.0, 0.0, 0.0, 0.0}, x: x, y: y, z: 20.0}
  end

  defp square(north, east, side),
    do:
      {:polygon,
       [
         near(north, east),
         near(north + side, east),
         near(north + side, east + side),
         near(north, east + side)
       ]}

  @tag timeout: 300_000
  test "a plan without a part leaves that part aboard, and clearing names what goes", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :ardupilot)

    plan = %Plan{
      items: [waypoint(0, 0), waypoint(10, 10)],
      fence: [{:inclusion, square(-50, -50, 200)}],
      rally: [{near(10, 0), 30.0}]
    }

    for kind <- Missions.kinds(),
        do: assert({:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", kind, plan))

    {:ok, empty} = Missions.import(File.read!(Path.join(@files, "no-fence-key.plan")), :plan)

    # A place to return to is not a fence.
    for kind <- Missions.kinds() do
      empty = %{empty | fence_return: {near(0, 0), 20.0}}
      assert {:error, [error]} = Missions.upload(gateway, "VID-001", kind, empty)
      assert error.expected =~ "there is none in it; to remove what is aboard, clear it"
    end

    assert {:ok, %{items: [_, _], fence: [_], rally: [_]}} = Missions.download_all(gateway, "VID-001")

    for {kind, removed} <- [mission: "2 items", fence: "4 corners", rally: "1 rally point", fence: "nothing"] do
      assert {:ok, %Result{status: :completed, details: %{"removed" => ^removed}}} =
               Missions.clear(gateway, "VID-001", kind)
    end

    assert {:ok, %{items: [], fence: [], rally: []}} = Missions.download_all(gateway, "VID-001")
  end

  @tag timeout: 300_000
  test "a plan that does not fit its own fence is sent with a remark; a fence that is a breach at once only if forced",
       %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :ardupilot)
    plan = %Plan{items: [waypoint(0, 0), waypoint(2000, 0)], fence: [{:inclusion, square(1000, 1000, 200)}]}

    assert {:ok, %Result{status: :completed, details: %{"remarks" => [first, second]}}} =
             Missions.upload(gateway, "VID-001", :mission, plan)

    assert first =~ "item 1 is outside" and second =~ "item 2 is outside"

    # On the ground it is told; the vehicle is outside as well.
    assert {:ok, %Result{status: :completed, details: %{"remarks" => ["the vehicle is outside" <> _ | _]}}} =
             Missions.upload(gateway, "VID-001", :fence, plan)

    assert {:ok, %Result{status: :completed}} = Missions.clear(gateway, "VID-001", :fence)
    assert {:ok, %Result{status: :completed}} = Params.set(gateway, "VID-001", "FENCE_ENABLE", 1)

    for {type, params} <- [
          {"set_mode", %{"mode" => "GUIDED"}},
          {"arm", %{}},
          {"takeoff", %{"altitude" => 10}}
        ],
        do:
          assert(
            {:ok, %Result{status: :completed}} =
              Commands.submit(gateway, vehicle: "VID-001", type: type, params: params)
          )

    eventually(fn ->
      match?(%{health: %{data: %{fence_enabled: true}}}, Store.vehicle(gateway, {"main", 1}).groups)
    end)

    assert {:ok, %Result{status: :denied, reason: reason, details: %{"rule" => "geofence"}}} =
             Missions.upload(gateway, "VID-001", :fence, plan)

    assert reason =~ "with this fence it is in breach at once; force sends it"
    assert {:ok, %{plan: %{fence: []}}} = Missions.download(gateway, "VID-001", :fence)
    assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", :fence, plan, force: true)
  end

  @tag timeout: 300_000
  test "names a parameter file's rows of another component and its duplicates", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :ardupilot)
    rows = "1\t1\tWPNAV_SPEED\t400\t9\n1\t154\tMNT_X\t2\t6\n1\t1\tWPNAV_SPEED\t450\t9\n"

    assert {:ok, %Result{status: :completed, details: %{"set" => 1, "remarks" => remarks}}} =
             Params.load(gateway, "VID-001", rows)

    assert ["left out, because they are of component 154" <> _, "WPNAV_SPEED is in the lines 1, 3" <> _] =
             remarks

    assert {:ok, %{value: 450.0}} = Params.get(gateway, "VID-001", "WPNAV_SPEED")
    assert {:error, [%{key: "line 1"}]} = Params.load(gateway, "VID-001", "7\t1\tWPNAV_SPEED\t300\t9\n")
    assert {:ok, %{value: 450.0}} = Params.get(gateway, "VID-001", "WPNAV_SPEED")
  end
end
