defmodule Aerie.Policy.Rules.Role do
  @moduledoc "The source must have the permission that the command needs (`Aerie.Policy.Roles`)."

  @behaviour Aerie.Policy.Rule

  alias Aerie.Policy.Roles

  @impl Aerie.Policy.Rule
  def check(_policy, facts, %{source: source}) do
    cond do
      Roles.allowed?(source, facts.permission) ->
        :ok

      source == nil ->
        {:deny, "#{facts.type} needs the permission #{facts.permission}, and nobody is signed in"}

      facts.permission in Roles.own() ->
        {:deny,
         "#{facts.type} needs the permission #{facts.permission}, which no role includes; #{source.name} (#{source.role}) was " <>
           "not given it"}

      true ->
        {:deny,
         "#{facts.type} needs the permission #{facts.permission}; #{source.name} is #{source.role}, which does not include it"}
    end
  end
end
