defmodule Aerie.Control.Policy.Rules do
  @moduledoc """
  The rules, in the order in which they are asked: what, who, when, in which state, where. Each is an
  `Aerie.Control.Policy.Rules.Rule`.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Rules, Switches}
  alias Aerie.Control.Policy.Intent.Context

  @rules [
    unknown: Rules.Unknown,
    number: Rules.Number,
    role: Rules.Role,
    lease: Rules.Lease,
    window: Rules.Window,
    condition: Rules.Condition,
    battery: Rules.Battery,
    mode: Rules.Mode,
    altitude: Rules.Altitude,
    geofence: Rules.Geofence,
    disarmed: Rules.Disarmed
  ]

  @names Keyword.keys(@rules)
  # What a command is and who sends it. These rules read nothing that a sender could fill.
  @of_sender [:unknown, :number, :role]

  @doc "The names of all rules."
  @spec names() :: [Policy.rule(), ...]
  def names, do: @names

  @doc "Those that depend on the command and its sender alone."
  @spec of_sender() :: [Policy.rule(), ...]
  def of_sender, do: @of_sender

  @doc "The first of some rules that denies a command gives the reason."
  @spec check([Policy.rule()], Policy.t(), Intent.t(), Context.t()) :: Policy.decision()
  def check(names, policy, facts, context) do
    facts = Switches.judge(facts, context, Rules.Mode.limits?(policy))

    Enum.find_value(@rules, :allow, fn {name, rule} ->
      if name in names, do: with(:ok <- rule.check(policy, facts, context), do: nil)
    end)
  end
end
