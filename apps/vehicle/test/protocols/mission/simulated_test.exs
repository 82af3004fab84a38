defmodule Protocols.Mission.SimulatedTest do
  @moduledoc "Transfers with the simulated vehicles over loopback: as strict as the firmware, with frames lost in both directions."
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.MissionStation
  alias Aerie.Vehicle.Firmware

  @home {473_977_420, 85_455_940}

  defp plan(count) do
    {x, y} = @home
    takeoff = %Item{command: 22, frame: 3, x: x, y: y, z: 20.0, params: {0.0, 0.0, 0.0, nil}}

    ways =
      for n <- 2..count//1,
          do: %Item{
            command: 16,
            frame: 3,
            x: x + n * 10,
            y: y + 7 * n,
            z: 20.5 + n / 10,
            params: {0.0, 2.0, 0.0, nil}
          }

    corner = fn north, east -> {x + north, y + east} end

    square = [
      corner.(-9_000, -9_000),
      corner.(-9_000, 9_000),
      corner.(90_000, 90_000),
      corner.(90_000, -9_000)
    ]

    %Plan{
      home: {@home, 488.0},
      items: [takeoff | ways],
      fence: [{:inclusion, {:polygon, square}}, {:exclusion, {:circle, corner.(5_000, 5_000), 10.0}}],
      rally: [{corner.(100, 100), 20.0}, {corner.(200, 200), 25.0}]
    }
  end

  defp start(firmware, faults \\ []) do
    station = MissionStation.open()
    {lat, lon} = @home

    {:ok, sim} =
      SimVehicle.start_link(
        firmware: firmware,
        link: "udpout:127.0.0.1:#{station.port}",
        home: {lat / 1.0e7, lon / 1.0e7, 488.0},
        seed: 7
      )

    station = MissionStation.meet(station, sim)

    for {name, value} <- faults,
        direction <- [:in, :out],
        do: :ok = SimVehicle.fault(sim, name, value, direction)

    {sim, station}
  end

  defp protocol(:px4), do: Firmware.Px4.Adapter
  defp protocol(_ardupilot), do: Firmware.Ardupilot.Adapter

  # Whether it can be flown PX4 says within a second or so; for a busy machine, or at a bad link, that may be too late.
  defp taken(:px4, 0), do: [:completed, :accepted]
  defp taken(_firmware, _type), do: [:completed]

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: mission, fence and rally points are sent, read and cleared" do
      {_sim, station} = start(unquote(firmware), loss: 0.05, duplicate: 0.05)
      protocol = protocol(unquote(firmware))
      plan = plan(12)

      {stored, station} =
        Enum.reduce(0..2, {%Plan{home: plan.home}, station}, fn type, {stored, station} ->
          items = Onboard.items(plan, type, protocol)
          {result, station} = MissionStation.transfer(station, {:upload, items}, type, protocol)
          assert %{status: status, on_board: :new} = result
          assert status in taken(unquote(firmware), type)
          assert result.opaque_id != nil == (unquote(firmware) == :px4)

          {result, station} = MissionStation.transfer(station, :download, type, protocol)
          assert %{status: :completed, on_board: :read} = result
          stored = Onboard.put(stored, type, result.items, protocol)
          {stored, station}
        end)

      assert length(stored.items) == 12

      assert Enum.map(stored.items, &{&1.command, &1.x, &1.y}) ==
               Enum.map(plan.items, &{&1.command, &1.x, &1.y})

      assert {stored.fence, stored.rally} == {plan.fence, plan.rally}

      for type <- 0..2 do
        {result, _station} = MissionStation.transfer(station, :clear, type, protocol)
        assert %{status: :completed, on_board: :new} = result
      end
    end

    for count <- [40, 500] do
      # Half a minute each.
      if count == 500, do: @tag(:long)

      test "#{firmware}: #{count} items at 25 % loss in both directions" do
        {sim, station} = start(unquote(firmware), loss: 0.25)
        protocol = protocol(unquote(firmware))
        items = Onboard.items(plan(unquote(count)), 0, protocol)
        {result, station} = MissionStation.transfer(station, {:upload, items}, 0, protocol)
        assert %{status: status, on_board: :new} = result
        assert status in taken(unquote(firmware), 0)
        assert SimVehicle.state(sim).mission.items == length(items)

        {result, _station} = MissionStation.transfer(station, :download, 0, protocol)
        assert %{status: :completed, items: read} = result
        assert length(read) == length(items)
      end
    end
  end

  test "PX4 rejects a mission without a take-off after it acknowledged it" do
    {sim, station} = start(:px4)
    :ok = SimVehicle.happen(sim, {:set_param, "MIS_TKO_LAND_REQ", 1})
    items = Onboard.items(%{plan(4) | items: tl(plan(4).items)}, 0, Firmware.Px4.Adapter)
    {result, _station} = MissionStation.transfer(station, {:upload, items}, 0, Firmware.Px4.Adapter)

    assert %{
             status: :rejected,
             on_board: :new,
             reason: "PX4 rejected it after the upload: it needs a take-off"
           } = result
  end

  test "PX4 rejects a fence that does not let home be" do
    {sim, station} = start(:px4)
    SimVehicle.await(sim, & &1.home)
    {x, y} = @home
    square = [{x - 9_000, y - 9_000}, {x - 9_000, y + 9_000}, {x + 9_000, y + 9_000}, {x + 9_000, y - 9_000}]
    items = Onboard.items(%Plan{fence: [{:exclusion, {:polygon, square}}]}, 1, Firmware.Px4.Adapter)
    {result, _station} = MissionStation.transfer(station, {:upload, items}, 1, Firmware.Px4.Adapter)

    assert %{
             status: :rejected,
             on_board: :new,
             reason: "PX4 rejected it after the upload: the fence does not" <> _
           } = result
  end

  # If the answer is lost, the item is sent again, and ArduPilot, which has ended the transfer, answers that with ERROR.
  for {loss, reasons} <- [{0.0, ["UNSUPPORTED"]}, {0.1, ["UNSUPPORTED", "ERROR"]}] do
    test "an item that ArduPilot refuses, #{loss} of the frames lost: the old mission stays" do
      {sim, station} = start(:ardupilot, loss: unquote(loss))
      old = Onboard.items(plan(5), 0, Firmware.Ardupilot.Adapter)

      {%{status: :completed}, station} =
        MissionStation.transfer(station, {:upload, old}, 0, Firmware.Ardupilot.Adapter)

      bad = List.update_at(Onboard.items(plan(9), 0, Firmware.Ardupilot.Adapter), 6, &%{&1 | command: 31_000})
      {result, _station} = MissionStation.transfer(station, {:upload, bad}, 0, Firmware.Ardupilot.Adapter)
      assert %{status: :rejected, on_board: :other, reason: "the vehicle refused it: " <> reason} = result
      assert reason in unquote(reasons)
      assert length(result.items) == length(old)
      assert SimVehicle.state(sim).mission.items == length(old)
    end
  end

  test "a cancelled upload leaves the old mission" do
    {sim, station} = start(:px4, delay: 20)
    items = Onboard.items(plan(50), 0, Firmware.Px4.Adapter)
    during = fn progress -> if progress.done == 10, do: :cancel end

    {result, _station} =
      MissionStation.transfer(station, {:upload, items}, 0, Firmware.Px4.Adapter, during: during)

    assert %{status: :cancelled, on_board: :other, items: []} = result
    assert SimVehicle.state(sim).mission.items == 0
  end

  test "a vehicle that is switched off in the middle, and comes back" do
    {sim, station} = start(:ardupilot)
    items = Onboard.items(plan(300), 0, Firmware.Ardupilot.Adapter)

    during = fn progress ->
      if progress.phase == :sending and div(100 * progress.done, progress.total) == 20,
        do: SimVehicle.reboot(sim)
    end

    {result, _station} =
      MissionStation.transfer(station, {:upload, items}, 0, Firmware.Ardupilot.Adapter, during: during)

    # Its transfer is forgotten: an item that comes now is an error.
    assert %{status: status, on_board: :other, items: []} = result
    assert status in [:rejected, :failed]
  end
end
