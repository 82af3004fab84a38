defmodule Aerie.Control.Policy.FlightPath.Shaping do
  @moduledoc """
  Whether parameters that are set keep the paths of a vehicle within the limits: with a fence or a limit of height in
  force, one that shapes a path (`MavCodec.Meaning.Shaping`) is judged as a path is. Without the permission `protection`
  a source may set a height within the limits of height, and no larger radius than the vehicle has; nothing else that
  shapes a path.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Fence, Intent}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Vehicle.Command.Refusal

  @doc "Whether all parameters do; the refusal of the first that does not."
  @spec check(Policy.t(), Intent.t(), Context.t()) :: :ok | Refusal.denial()
  def check(policy, facts, context) do
    (limited?(policy) &&
       Enum.find_value(facts.sets, fn {name, value} ->
         wrong(MavCodec.Meaning.Shaping.get(name), {name, value}, policy, context)
       end)) || :ok
  end

  @doc "Whether a policy limits where vehicles fly."
  @spec limited?(Policy.t()) :: boolean()
  def limited?(policy),
    do: Enum.any?([policy.fence, policy.max_altitude, policy.min_altitude, policy.max_altitude_msl])

  defp wrong(nil, _set, _policy, _context), do: nil

  defp wrong(:unknown, {name, _value}, _policy, _context),
    do: Refusal.deny(:shape_unknown, name: name)

  defp wrong(row, {name, value}, policy, context) do
    within? =
      case row.shapes do
        :speed -> true
        _shape when not is_number(value) -> false
        :height -> height?(value * row.metres, policy)
        :width -> policy.fence == nil or abs(value) <= abs(Map.get(context.params, row.name, 0))
        :path -> false
      end

    if not within?, do: Refusal.deny(:shape_beyond, name: name, meaning: row.meaning, value: value)
  end

  # A fence with heights may have another limit at each place.
  defp height?(metres, %{max_altitude_msl: nil} = policy) do
    metres >= (policy.min_altitude || 0) and (policy.max_altitude == nil or metres <= policy.max_altitude) and
      (policy.fence == nil or not Fence.heights?(policy.fence))
  end

  defp height?(_metres, _policy), do: false
end
