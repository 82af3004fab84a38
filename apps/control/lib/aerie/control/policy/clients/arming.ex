defmodule Aerie.Control.Policy.Clients.Arming do
  @moduledoc """
  Decides whether a vehicle that asks before it arms may do so (`Aerie.Vehicle.Session.ArmAuthorization`): the policy decides as about
  `arm`, but for roles and rates, because the source of the order to arm is unknown.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Audit, Intent, ControlLease, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal

  @behaviour Aerie.Vehicle.Session.ArmAuthorization

  @impl Aerie.Vehicle.Session.ArmAuthorization
  def decide(gateway, snapshot, now) do
    decision =
      case Policy.Store.get(gateway) do
        nil -> Refusal.deny(:no_policy_to_arm)
        policy -> verdict(policy, Context.of(gateway, snapshot, nil, now))
      end

    entry = %{
      "type" => "decision",
      "command" => "arm",
      "vehicle" => snapshot.id,
      "via" => "arm authorization"
    }

    recorded(decision, gateway, snapshot, entry)
    decision
  end

  defp recorded(:allow, gateway, _snapshot, entry),
    do: Audit.note(gateway, Map.put(entry, "decision", "allow"))

  # A vehicle may ask as often as it likes.
  defp recorded(denial, gateway, snapshot, entry),
    do: Audit.refusal(gateway, Roles.principal(:vehicle, snapshot.id, :viewer), denial, entry)

  # In the name of the lease's holder: the rule only asks whether a lease is required.
  defp verdict(policy, context) do
    name = with %ControlLease{holder: holder} <- context.lease, do: holder
    source = Roles.principal(:vehicle, name || "the vehicle", :admin)
    Policy.decide(policy, Intent.named("arm"), %{context | source: source})
  end
end
