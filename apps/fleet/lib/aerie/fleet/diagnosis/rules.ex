defmodule Aerie.Fleet.Diagnosis.Rules do
  @moduledoc "Behaviour of a module with rules: it names its conditions, and finds those that facts show."

  alias Aerie.Fleet.Diagnosis.{Condition, Observations}

  @doc "Each condition and its meaning."
  @callback names() :: [{atom(), String.t()}]

  @doc "The conditions that facts with their trend show."
  @callback check(Observations.t()) :: [Condition.t()]

  @doc "By how much a counter of a link, or of the endpoints of an owner, grew."
  @spec grown(Observations.t(), {:link | :endpoints, String.t()}, atom()) :: non_neg_integer()
  def grown(facts, key, counter), do: facts.grown |> Map.get(key, %{}) |> Map.get(counter, 0)
end
