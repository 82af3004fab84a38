defmodule Aerie.Fleet.Remote.MessageTest do
  @moduledoc "What a hub takes of the messages of others, and what it does not."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Remote.Message

  @now 1_800_000_000_000_000

  defp body(group, data),
    do: Bridge.Message.state("V-1", group, data, 5, @now, %{epoch: 7, gateway: "gateway-V-1"})

  test "a group that a gateway publishes comes back as the group that it has" do
    data = %{lat: 47.1, lon: 8.5, alt_msl: 400, alt_rel: nil, heading: 12.0}

    assert {:ok, %{vehicle: "V-1", gateway: "gateway-V-1", epoch: 7, time: @now, time_boot_ms: 5} = message} =
             Message.parse("V-1", "position", body("position", data))

    assert {:group, :position, ^data} = message.content

    battery = %{voltage: 12.1, remaining: 0.5, batteries: [%{id: 1, voltage: 12.1, charge_state: "OK"}]}

    assert {:ok, %{content: {:group, :battery, ^battery}}} =
             Message.parse("V-1", "battery", body("battery", battery))

    checks = [%{id: "0x01AEEF7E", name: "check_modes_offboard_signal_lost", severity: 3}]

    health = %{
      unhealthy: ["gps"],
      ekf: %{flags: 3, velocity: 0.1},
      vibration: [0.1, 0.2, 0.3],
      arming_checks: checks
    }

    assert {:ok, %{content: {:group, :health, ^health}}} =
             Message.parse("V-1", "health", body("health", health))
  end

  test "what a gateway says of a vehicle comes back" do
    snapshot = %Aerie.Vehicle.Snapshot{
      network: "main",
      system_id: 300,
      autopilot: :px4,
      vehicle_type: "copter",
      firmware: "1.15",
      status: :stale,
      last_heard: @now - 4_000_000
    }

    {:ok, %{content: {:facts, facts}}} =
      Message.parse("V-1", "gateway", body("gateway", Message.facts(snapshot, @now)))

    assert facts == snapshot
  end

  test "fields that nobody knows, values of another kind, and other vehicles' bodies are not taken" do
    odd = %{"lat" => "north", "lon" => 8, "nonsense" => 1, "heading" => %{"a" => 1}}
    body = JSON.encode!(%{vehicle: "V-1", group: "position", time: "2027-01-15T08:00:00Z", data: odd})
    assert {:ok, %{gateway: nil, content: {:group, :position, data}}} = Message.parse("V-1", "position", body)
    assert data[:lon] == 8
    refute is_map_key(data, :lat)
    assert Message.parse("V-2", "position", body) == :error
    assert Message.parse("V-1", "gps", body) == :error
    assert Message.parse("V-1", "position", String.duplicate(" ", 40_000)) == :error
    assert Message.parse("V-1", "position", "no json") == :error
  end

  test "only subjects of states that are known" do
    assert Message.subject("fleet.test.V-1.state.position") == {:ok, "V-1", "position"}
    assert Message.subject("fleet.test.V-1.state.gateway") == {:ok, "V-1", "gateway"}

    for odd <- ["fleet.test.V-1.state.other", "fleet.test.V 1.state.gps", "fleet.test.state.gps"],
        do: assert(Message.subject(odd) == :error)
  end
end
