defmodule Aerie.Control.Policy.Rules.Lease do
  @moduledoc """
  One source is in charge of a vehicle (`Aerie.Control.Policy.ControlLease`): nobody else commands it, and with `policy.lease.required` nobody
  before taking charge. What holds the vehicle or brings it down, and what only asks for messages, is free for all whose role
  allows it.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.{Intent, ControlLease}
  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(policy, %{control: change}, context) when change != nil do
    with {:ok, _lease} <-
           ControlLease.change(context.lease, change, context.source, "", policy.lease, context.now),
         do: :ok
  end

  def check(_policy, %{ends_flight?: true}, _context), do: :ok
  def check(_policy, %{permission: :telemetry}, _context), do: :ok
  def check(%{lease: %{required: false}}, _facts, %{lease: nil}), do: :ok

  def check(_policy, facts, %{lease: nil}), do: Refusal.deny(:nobody_took_it, command: Intent.label(facts))

  def check(_policy, _facts, %{lease: lease, source: source}) do
    if source != nil and ControlLease.who(source) == lease.holder,
      do: :ok,
      else: Refusal.deny(:in_charge_of_all, holder: lease.holder, since: ControlLease.since(lease))
  end
end
