defmodule Aerie.Policy.Rules.Battery do
  @moduledoc "No take-off with less charge than `takeoff_battery`. Arming and starting a mission on the ground are judged like it."

  @behaviour Aerie.Policy.Rule

  @types ~w(takeoff arm mission_start)

  @impl Aerie.Policy.Rule
  def check(%{takeoff_battery: nil}, _facts, _context), do: :ok
  def check(_policy, %{type: "mission_start"}, %{in_air: true}), do: :ok

  def check(%{takeoff_battery: floor}, %{type: type}, context) when type in @types do
    case context.battery do
      nil ->
        {:deny, "#{type} needs #{percent(floor)} of the battery's charge; how much is left is not known"}

      left when left < floor ->
        {:deny, "#{type} needs #{percent(floor)} of the battery's charge; #{percent(left)} is left"}

      _enough ->
        :ok
    end
  end

  def check(_policy, _facts, _context), do: :ok

  # Not rounded up: 29.9 % is not 30 %.
  defp percent(share),
    do:
      "#{share |> Kernel.*(100) |> Float.floor(1) |> Float.to_string() |> String.replace_suffix(".0", "")} %"
end
