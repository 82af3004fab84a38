defmodule Aerie.Policy.Rules.Role do
  @moduledoc "The source must have the permission that the command needs (`Aerie.Policy.Roles`)."

  @behaviour Aerie.Policy.Rule

  alias Aerie.Policy.Roles

  @impl Aerie.Policy.Rule
  def check(_policy, facts, %{source: source}) do
    case Enum.find([facts.permission | facts.also], &(not Roles.allowed?(source, &1))) do
      nil -> :ok
      lacking -> {:deny, "#{facts.type} needs the permission #{lacking}" <> why(lacking, source)}
    end
  end

  defp why(_lacking, nil), do: ", and nobody is signed in"

  defp why(lacking, source) do
    if lacking in Roles.own(),
      do: ", which no role includes; #{source.name} (#{source.role}) was not given it",
      else: "; #{source.name} is #{source.role}, which does not include it"
  end
end
