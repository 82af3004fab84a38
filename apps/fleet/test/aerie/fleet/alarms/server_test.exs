defmodule Aerie.Fleet.Alarms.ServerTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Base.{PubSub, Store}
  alias Aerie.Fleet.Alarms.Server
  alias Aerie.Vehicle.{Event, Journal}

  setup do
    gateway = Aerie.GatewayCase.start_gateway(%{}, with: [:router])
    start_supervised!({Server, gateway: gateway, look_ms: 5})
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

    defaults = %{autopilot: :px4, vehicle_type: "copter", firmware: nil, last_heard: 1, links: ["radio"]}
    Store.put_vehicle(gateway, {"main", 9}, Map.merge(defaults, snapshot))
  end

  defp texts(gateway),
    do: for(alarm <- elem(Server.list(gateway), 0), do: {alarm.key, alarm.over != nil, alarm.by})

  test "a vehicle that is lost is an alarm for all, until it is back and somebody has seen it", c do
    PubSub.subscribe(c.gateway, {:notice, :console_alarms})
    put_vehicle(c.gateway, :lost)
    assert_receive {:fleet, {:notice, :console_alarms}, %{sound: :critical, waiting: 1}}
    assert [{key, false, nil}] = texts(c.gateway)
    assert :ok = Server.acknowledge(c.gateway, :all, "ann")
    assert [{^key, false, "ann"}] = texts(c.gateway)
    assert Server.summary(c.gateway).sound == nil
    put_vehicle(c.gateway, :online)
    eventually(fn -> texts(c.gateway) == [] end)
  end

  test "a link that is down is one, and goes with the link", c do
    Store.put_link(c.gateway, "radio", %{id: "radio", status: :down, text: "no such device"})
    eventually(fn -> match?([{{:link, "radio"}, false, nil}], texts(c.gateway)) end)
    Store.delete_link(c.gateway, "radio")
    eventually(fn -> match?([{{:link, "radio"}, true, nil}], texts(c.gateway)) end)
  end

  test "after a restart those of the journal are there again, and nothing is acknowledged", c do
    event = Event.new("VID-009", "gps.lost", 1, System.os_time(:microsecond), nil, %{"fix_name" => "NO_FIX"})
    :ok = Journal.commit(c.gateway, "VID-009", %{}, [event])
    PubSub.publish(c.gateway, :events, event)
    eventually(fn -> match?([{_key, false, nil}], texts(c.gateway)) end)
    :ok = Server.acknowledge(c.gateway, :all, "ann")
    stop_supervised!(Server)
    assert Server.list(c.gateway) == {[], 0}
    assert %{waiting: 0} = Server.summary(c.gateway)
    start_supervised!({Server, gateway: c.gateway, look_ms: 5})
    assert [{_key, false, nil}] = texts(c.gateway)
  end
end
