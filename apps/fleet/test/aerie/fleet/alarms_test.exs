defmodule Aerie.Fleet.AlarmsTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Base.{PubSub, Store}
  alias Aerie.Fleet.Alarms
  alias Aerie.Vehicle.{Event, Options}
  alias Aerie.Vehicle.Events.{Detector, Journal}
  alias Aerie.Vehicle.Events.Detector.Observation

  setup do
    gateway = Aerie.GatewayCase.start_gateway(%{}, with: [:router])
    start_supervised!({Alarms, gateway: gateway, look_ms: 5})
    {:ok, gateway: gateway}
  end

  defp put_vehicle(gateway, status) do
    groups = %{mode: %{at: 1, time_boot_ms: 1, data: %{armed: true, failsafe: false}}}

    snapshot = %{
      id: "VID-009",
      key: {"main", 9},
      network: "main",
      system_id: 9,
      status: status,
      groups: groups
    }

    defaults = %Aerie.Vehicle.Snapshot{
      autopilot: :px4,
      vehicle_type: "copter",
      firmware: nil,
      last_heard: 1,
      links: ["radio"]
    }

    Store.put_vehicle(gateway, {"main", 9}, Map.merge(defaults, snapshot))
  end

  defp texts(gateway),
    do: for(alarm <- elem(Alarms.list(gateway), 0), do: {alarm.key, alarm.over != nil, alarm.by})

  test "a vehicle that is lost is an alarm for all, until it is back and somebody has seen it", c do
    PubSub.subscribe(c.gateway, {:notice, :console_alarms})
    put_vehicle(c.gateway, :lost)
    assert_receive {:fleet, {:notice, :console_alarms}, %{sound: :critical, waiting: 1}}
    assert [{key, false, nil}] = texts(c.gateway)
    assert :ok = Alarms.acknowledge(c.gateway, :all, "ann")
    assert [{^key, false, "ann"}] = texts(c.gateway)
    assert Alarms.summary(c.gateway).sound == nil
    put_vehicle(c.gateway, :online)
    eventually(fn -> texts(c.gateway) == [] end)
  end

  test "a link that is down is one, and goes with the link", c do
    Store.put_link(c.gateway, "radio", %{id: "radio", status: :down, text: "no such device"})
    eventually(fn -> match?([{{:link, "radio"}, false, nil}], texts(c.gateway)) end)
    Store.delete_link(c.gateway, "radio")
    eventually(fn -> match?([{{:link, "radio"}, true, nil}], texts(c.gateway)) end)
  end

  # The detector's step is committed as the vehicle's event loop does it.
  defp observe(gateway, detector, remaining, told? \\ true) do
    data = %{mode: "GUIDED", armed: true, in_air: true, remaining: remaining}
    observation = Observation.new(:state, System.os_time(:microsecond), 1000, data)
    {detector, events, params} = Detector.observe(detector, observation)
    :ok = Journal.commit(gateway, detector.vehicle, detector, if(told?, do: events, else: []), params)
    {detector, events}
  end

  defp detector do
    options = Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 9})
    Detector.new(%{options | id: "VID-009"})
  end

  test "a battery that was nearly empty and is charged is over, with or without the event that says so", c do
    put_vehicle(c.gateway, :online)
    {detector, _events} = observe(c.gateway, detector(), 0.9)

    for told? <- [true, false], reduce: detector do
      detector ->
        {detector, [_low, %Event{type: "battery.critical"}]} = observe(c.gateway, detector, 0.05)
        eventually(fn -> match?([{{:battery, "VID-009"}, false, nil}], texts(c.gateway)) end)
        {detector, [%Event{type: "battery.recovered"}]} = observe(c.gateway, detector, 0.94, told?)
        eventually(fn -> match?([{{:battery, "VID-009"}, true, nil}], texts(c.gateway)) end)
        :ok = Alarms.acknowledge(c.gateway, :all, "ann")
        assert texts(c.gateway) == []
        detector
    end
  end

  test "after a restart what holds is there again, and nothing is acknowledged", c do
    put_vehicle(c.gateway, :online)
    {detector, _events} = observe(c.gateway, detector(), 0.05)
    eventually(fn -> match?([{_key, false, nil}], texts(c.gateway)) end)
    :ok = Alarms.acknowledge(c.gateway, :all, "ann")
    stop_supervised!(Alarms)
    assert Alarms.list(c.gateway) == {[], 0}
    assert %{waiting: 0} = Alarms.summary(c.gateway)
    start_supervised!({Alarms, gateway: c.gateway, look_ms: 5})
    assert [{{:battery, "VID-009"}, false, nil}] = texts(c.gateway)

    # What ended while it was down is over.
    stop_supervised!(Alarms)
    {_detector, _events} = observe(c.gateway, detector, 0.94)
    start_supervised!({Alarms, gateway: c.gateway, look_ms: 5})
    assert [{{:battery, "VID-009"}, true, nil}] = texts(c.gateway)
  end
end
