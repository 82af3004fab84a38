defmodule Aerie.Fleet.Operations.Readiness do
  @moduledoc """
  What decides beside a vehicle's snapshot whether it is ready (`Aerie.Vehicle.Snapshot.readiness/2`): links, events,
  what is wanted aboard, who is in charge, and the policy's limits. It reads tables and asks nobody.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Snapshot

  @aboard ~w(geofence.plan geofence.enabled mission.plan)
  # For a gateway without a policy.
  @reserve 0.4
  # ArduPilot repeats what keeps it from arming every half minute.
  @events_us 60_000_000

  @type t :: Snapshot.readiness()

  @doc """
  Whether a vehicle is ready; nil if no gateway knows it. `viewer`: the name of the caller, or `:anybody` for its
  holder.
  """
  @spec of(Names.gateway(), String.t(), viewer :: String.t() | nil | :anybody) :: t() | nil
  def of(gateway, id, viewer) do
    with %{} = vehicle <- Merge.vehicle(gateway, id), do: judge(facts(gateway), vehicle, viewer)
  end

  @doc "The same of vehicles that were read already, by their ids."
  @spec all(Names.gateway(), [Snapshot.t()], viewer :: String.t() | nil | :anybody) :: %{String.t() => t()}
  def all(gateway, vehicles, viewer) do
    facts = facts(gateway)
    Map.new(vehicles, &{&1.id, judge(facts, &1, viewer)})
  end

  # What counts for all vehicles now.
  defp facts(gateway) do
    policy = Policy.in_force(gateway) || %{ready_battery: @reserve, takeoff_battery: nil}

    %{
      gateway: gateway,
      now: System.os_time(:microsecond),
      links: Store.links(gateway),
      leases: Policy.control_leases(gateway),
      reserve: policy.ready_battery,
      floor: policy.takeoff_battery
    }
  end

  defp judge(%{gateway: gateway} = facts, %{id: id} = vehicle, viewer) do
    Snapshot.readiness(vehicle, %{
      now: facts.now,
      links: facts.links,
      events: events(vehicle, facts),
      aboard: Shadow.wanted(gateway, id, @aboard),
      holder: with(%{holder: name} <- facts.leases[vehicle.key], do: name),
      viewer: viewer,
      reserve: facts.reserve,
      floor: facts.floor
    })
  end

  # One that says that it can be armed has no complaints.
  defp events(vehicle, %{gateway: gateway} = facts) do
    if Snapshot.data(vehicle, :health)[:ready_to_arm] == true do
      []
    else
      now = Snapshot.now(vehicle, facts.links, facts.now)
      Journal.recent(gateway, vehicle.id, since: now - @events_us)
    end
  end
end
