defmodule Aerie.Control.Policy.Rules.Battery do
  @moduledoc """
  No take-off with less charge than `takeoff_battery`. Arming is judged like it, and on the ground whatever else may make
  the vehicle take off (`Aerie.Control.Policy.Intent`, `implies`).
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent

  @types ~w(takeoff arm)

  @impl Aerie.Control.Policy.Rules.Rule
  def check(%{takeoff_battery: nil}, _facts, _context), do: :ok

  def check(policy, facts, context) do
    if Enum.any?(Intent.types(facts, context), &(&1 in @types)),
      do: charge(policy.takeoff_battery, Intent.label(facts), context),
      else: :ok
  end

  defp charge(floor, type, context) do
    case context.battery do
      nil ->
        {:deny, "#{type} needs #{percent(floor)} of the battery's charge; how much is left is not known"}

      left when left < floor ->
        {:deny, "#{type} needs #{percent(floor)} of the battery's charge; #{percent(left)} is left"}

      _enough ->
        :ok
    end
  end

  # Not rounded up: 29.9 % is not 30 %.
  defp percent(share),
    do:
      "#{share |> Kernel.*(100) |> Float.floor(1) |> Float.to_string() |> String.replace_suffix(".0", "")} %"
end
