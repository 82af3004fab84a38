defmodule Aerie.Fleet.Operations.ReadinessTest do
  @moduledoc "What decides beside the snapshot: the policy, who is in charge, complaints, and what is wanted aboard."
  use Aerie.ShadowCase, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Fleet
  alias Aerie.Fleet.Operations.Requests
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal

  @moduletag :tmp_dir
  @key {"main", 7}
  @ops %{name: "ops", role: :operator, permissions: []}

  setup %{tmp_dir: dir} do
    gateway = start_commands(dir, policy: [ready_battery: 0.6, takeoff_battery: 0.5])
    start_shadow(gateway, dir)
    ready(gateway)
    %{gateway: gateway}
  end

  defp ready(gateway, changes \\ %{}) do
    put_vehicle(gateway, %{armed: false})
    vehicle = Store.vehicle(gateway, "VID-007")
    at = System.os_time(:microsecond)

    groups =
      %{
        battery: %{remaining: 0.9},
        gps: %{fix: 3, satellites: 12},
        health: %{ready_to_arm: true, unhealthy: []}
      }
      |> Map.merge(changes)
      |> Map.new(fn {name, data} -> {name, %{at: at, data: data}} end)

    Store.put_vehicle(gateway, @key, %{
      vehicle
      | time_boot_ms: 60_000,
        groups: Map.merge(vehicle.groups, groups)
    })
  end

  defp point(gateway, name, viewer \\ :anybody),
    do: Enum.find(Fleet.readiness(gateway, "VID-007", viewer).points, &(&1.name == name))

  test "an unknown vehicle has no readiness", %{gateway: gateway} do
    assert Fleet.readiness(gateway, "VID-404") == nil
    assert %{state: :ready} = Fleet.readiness(gateway, "VID-007")
    vehicles = Fleet.vehicles(gateway)
    assert %{"VID-007" => %{state: :ready}} = Fleet.readinesses(gateway, vehicles)
  end

  test "the policy says how much charge is wanted, from the next look on", %{gateway: gateway} do
    ready(gateway, %{battery: %{remaining: 0.55}})
    assert %{state: :not_ready, text: "55 % left; 60 % are wanted."} = point(gateway, :battery)
    ready(gateway, %{battery: %{remaining: 0.45}})
    assert %{text: "45 % left; the policy wants 50 % for a take-off."} = point(gateway, :battery)
    :ok = Policy.Store.put(gateway, %{ready_battery: 0.2})
    assert %{state: :ready} = point(gateway, :battery)
  end

  test "somebody in charge keeps others from it", %{gateway: gateway} do
    rules = Policy.in_force(gateway).lease
    {:ok, _lease} = Holders.change(gateway, @key, {:take, nil, nil}, @ops, "test", rules)
    assert %{state: :ready} = Fleet.readiness(gateway, "VID-007", "ops")
    assert %{state: :not_ready} = Fleet.readiness(gateway, "VID-007", "ann")
    assert %{state: :ready, text: "ops is in charge of it."} = point(gateway, :charge)
  end

  test "the vehicle's complaints of the last minute", %{gateway: gateway} do
    complain = fn seq, text, at ->
      event = Event.new("VID-007", "statustext", seq, at, nil, %{"text" => text, "severity" => 2})
      Journal.commit(gateway, "VID-007", nil, [event])
    end

    now = System.os_time(:microsecond)
    complain.(1, "PreArm: Long ago", now - 3_600_000_000)
    complain.(2, "PreArm: Check mag field", now)
    assert %{state: :ready} = point(gateway, :arming)
    ready(gateway, %{health: %{ready_to_arm: false}})
    assert %{state: :not_ready, text: "Check mag field."} = point(gateway, :arming)
  end

  test "a mission that is wanted and that nobody reports is not known", %{gateway: gateway} do
    change = %{"desired" => %{"geofence" => %{"enabled" => true}}}
    {:ok, _desired} = Shadow.update(gateway, "VID-007", change)
    assert %{state: :unknown} = point(gateway, :fence)
    assert %{state: :ready} = point(gateway, :mission)
    assert %{state: :unknown} = Fleet.readiness(gateway, "VID-007")
  end

  test "NATS and REST give the same, in the name of the caller", %{gateway: gateway} do
    context = %{gateway: gateway, vehicle: "VID-007", source: nil}

    assert {:ok, %{state: :ready, points: [%{name: :link} | _]}} =
             Requests.Readiness.run(%{vehicle: nil}, context)

    named = Requests.Readiness.run(%{vehicle: "VID-007"}, %{context | vehicle: "gateway-VID-001"})
    assert {:ok, %{state: :ready}} = named
    assert {:error, {:unknown, "there is no vehicle X"}} = Requests.Readiness.run(%{vehicle: "X"}, context)
  end
end
