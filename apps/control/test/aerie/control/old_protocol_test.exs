defmodule Aerie.Control.OldProtocolTest do
  @moduledoc """
  Vehicles that speak MAVLink 1, which has no `mission_type` and no ids above 255 (F2, F9, W4): what would be another
  message there is refused before anything is sent.
  """
  use Aerie.TransferCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Control.{Missions, Params}
  alias Protocols.Mission.{Item, Plan}

  @moduletag :tmp_dir
  @moduletag :capture_log

  @place {473_900_000, 85_400_000}
  @fence [{:inclusion, {:polygon, [@place, {474_000_000, 85_400_000}, {474_000_000, 85_500_000}]}}]
  @limits %{timeout_ms: 60_000}

  # It hears both versions, as ArduPilot does on a port with SERIALn_PROTOCOL 1.
  defp eight_aboard(dir, mavlink) do
    {gateway, port} = start(dir)
    sim = fly(gateway, port, firmware: :ardupilot, mavlink: mavlink, camera: 100)
    {x, y} = @place
    items = for n <- 1..8, do: %Item{command: 16, frame: 3, x: x + n * 10_000, y: y, z: 20.0}
    plan = %Plan{items: items, fence: @fence, rally: [{@place, 30.0}]}
    assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", :mission, plan)
    {gateway, sim, plan}
  end

  defp aboard(gateway) do
    {:ok, %{plan: plan}} = Missions.download(gateway, "VID-001", :mission)
    length(plan.items)
  end

  test "MAVLink 1: fences and rally points are refused, and the mission stays", %{tmp_dir: dir} do
    {gateway, sim, plan} = eight_aboard(dir, 1)
    session = Names.whereis(gateway, :session, {"main", 1})
    assert %{mavlink_version: 1} = Store.vehicle(gateway, "VID-001")

    for {kind, word} <- [fence: "fence", rally: "rally points"] do
      expected = "this vehicle speaks MAVLink 1, which has no #{word}; set its port to MAVLink 2"

      for ask <- [
            fn -> Missions.upload(gateway, "VID-001", kind, plan) end,
            fn -> Missions.clear(gateway, "VID-001", kind) end,
            fn -> Missions.download(gateway, "VID-001", kind) end
          ],
          do: assert({_kind, %Result{status: :rejected, reason: ^expected}} = ask.())

      assert aboard(gateway) == 8
    end

    assert {:error,
            %Result{status: :rejected, reason: "this vehicle speaks MAVLink 1, which has no par" <> _}} =
             Params.list(gateway, "VID-001", component: 100)

    assert {:ok, %Result{status: :rejected}} = Params.set(gateway, "VID-001", "CAM_MODE", 1, component: 100)
    # What version 1 can say goes on as ever, through the same processes.
    assert {:ok, %{value: _number}} = Params.get(gateway, "VID-001", "WPNAV_SPEED")
    assert {:ok, %Result{status: :completed}} = Missions.clear(gateway, "VID-001", :mission)
    assert Names.whereis(gateway, :session, {"main", 1}) == session
    assert Process.alive?(sim)
  end

  test "both versions: a fence goes out in MAVLink 2, and the mission stays", %{tmp_dir: dir} do
    {gateway, _sim, plan} = eight_aboard(dir, :both)
    options = Map.to_list(@limits)

    for kind <- [:fence, :rally] do
      assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", kind, plan, options)
      assert aboard(gateway) == 8
      assert {:ok, %{plan: read}} = Missions.download(gateway, "VID-001", kind, options)
      assert {read.fence, read.rally} == if(kind == :fence, do: {plan.fence, []}, else: {[], plan.rally})
      assert {:ok, %Result{status: :completed}} = Missions.clear(gateway, "VID-001", kind, options)
      assert aboard(gateway) == 8
    end
  end
end
