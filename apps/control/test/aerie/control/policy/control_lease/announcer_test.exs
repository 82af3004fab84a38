defmodule Aerie.Control.Policy.ControlLease.AnnouncerTest do
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frame: 2]

  alias Aerie.Base.{PubSub, Store}
  alias Aerie.Control.Policy.ControlLease.Announcer
  alias Aerie.Control.Policy.ControlLease.Holders
  alias MavCodec.Messages, as: M

  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}

  defp deliver(gateway, frames),
    do: Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, frames)

  test "the state has the user in charge and what the vehicle says about it (X15), and a change is an event" do
    gateway = start_gateway(%{}, with: [:router])
    start_supervised!({Announcer, gateway: gateway})
    deliver(gateway, [frame(@copter, 1_000_000)])
    eventually(fn -> Store.vehicle(gateway, {"main", 1}) end)
    PubSub.subscribe(gateway, :events)
    source = %{name: "olga", role: :operator, permissions: []}
    rules = %{required: false, take_over: :operator}
    change = &Holders.change(gateway, {"main", 1}, &1, source, "nats", rules)
    assert {:ok, _lease} = change.({:take, nil, nil})
    assert_receive {:fleet, :events, %{type: "operator.changed", data: data}}
    assert %{"operator" => "olga", "before" => nil, "via" => "nats"} = JSON.decode!(JSON.encode!(data))
    deliver(gateway, [frame(%M.ControlStatus{flags: 3, gcs_main: 245}, 2_000_000)])
    state = fn -> get_in(Store.vehicle(gateway, "VID-001").groups, [:operator, :data]) end

    eventually(fn ->
      match?(%{name: "olga", via: "nats", system: 245, takeover_allowed: true, offered_to: nil}, state.())
    end)

    assert {:ok, _lease} = change.({:offer, :anyone})
    eventually(fn -> state.().offered_to == "*" end)
    assert {:ok, nil} = change.(:release)
    assert_receive {:fleet, :events, %{type: "operator.changed", data: data}}
    assert %{"operator" => nil, "before" => "olga"} = JSON.decode!(JSON.encode!(data))
    eventually(fn -> match?(%{name: nil, system: 245}, state.()) end)
  end
end
