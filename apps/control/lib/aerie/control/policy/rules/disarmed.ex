defmodule Aerie.Control.Policy.Rules.Disarmed do
  @moduledoc """
  Raw MAVLink that a disarmed vehicle may keep, and drive off with when it is armed, is refused (`t:Aerie.Vehicle.Command.Type.t/0`, `disarmed`).
  Commands of the table are refused by the firmware's adapter, with its reason (`Aerie.Vehicle.Protocol.plan/3`).
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(_policy, %{stored?: true} = facts, %{armed: false}),
    do: Refusal.deny(:disarmed, command: Intent.label(facts))

  def check(_policy, _facts, _context), do: :ok
end
