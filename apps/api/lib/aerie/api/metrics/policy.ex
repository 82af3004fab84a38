defmodule Aerie.Api.Metrics.Policy do
  @moduledoc "Metric families about the policy for commands and its audit log."

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Audit
  alias Aerie.Api.Metrics.Text

  @doc "The families, from the read model's counters and the state of the log."
  @spec families(Aerie.Base.Names.gateway(), map()) :: [Text.family()]
  def families(gateway, counters) do
    decisions = for {{:policy, decision, rule}, n} <- counters, do: {[decision: decision, rule: rule], n}

    [
      {"gateway_policy_decisions_total", :counter,
       "Decisions about commands, by decision and the rule that denied.", Enum.sort(decisions)},
      {"gateway_policy_stale", :gauge,
       "1 while the policy in force is not that of the files, because those have errors.",
       [{[], match?(%{problem: %{}}, Policy.status(gateway))}]},
      {"gateway_audit_failing", :gauge, "1 while the audit log cannot be written.",
       [{[], Audit.failing(gateway) != nil}]},
      {"gateway_audit_records_missed_total", :counter, "Records that the audit log could not take.",
       [{[], Map.get(counters, {:audit, :missed}, 0)}]}
    ]
  end

  @doc "Whether these families show a counter."
  @spec own?(term()) :: boolean()
  def own?({:policy, _decision, _rule}), do: true
  def own?({:audit, :missed}), do: true
  def own?(_other), do: false
end
