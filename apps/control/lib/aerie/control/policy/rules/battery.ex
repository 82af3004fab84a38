defmodule Aerie.Control.Policy.Rules.Battery do
  @moduledoc """
  No take-off with less charge than `takeoff_battery`. Arming is judged like it, and on the ground whatever else may make
  the vehicle take off (`Aerie.Control.Policy.Intent`, `implies`).
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.Intent
  alias Aerie.Vehicle.Command.Refusal

  @types ~w(takeoff arm)

  @impl Aerie.Control.Policy.Rules.Rule
  def check(%{takeoff_battery: nil}, _facts, _context), do: :ok

  def check(policy, facts, context) do
    if Enum.any?(Intent.types(facts, context), &(&1 in @types)),
      do: charge(policy.takeoff_battery, Intent.label(facts), context),
      else: :ok
  end

  defp charge(floor, command, %{battery: nil}),
    do: Refusal.deny(:battery_unknown, command: command, floor: percent(floor))

  defp charge(floor, command, %{battery: left}) when left < floor,
    do: Refusal.deny(:battery_low, command: command, floor: percent(floor), left: percent(left))

  defp charge(_floor, _command, _enough), do: :ok

  # Not rounded up: 29.9 % is not 30 %.
  defp percent(share),
    do:
      "#{share |> Kernel.*(100) |> Float.floor(1) |> Float.to_string() |> String.replace_suffix(".0", "")} %"
end
