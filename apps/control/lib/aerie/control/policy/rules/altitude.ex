defmodule Aerie.Control.Policy.Rules.Altitude do
  @moduledoc """
  Heights that a command may ask for: at most `max_altitude` and at least `min_altitude` above home, at most
  `max_altitude_msl` above mean sea level. Above home also means above where the vehicle took off, so that nobody lifts
  a limit by moving home. A command that leaves the vehicle at its height is not judged.
  """

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.{FlightPath, Intent}
  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(%{max_altitude: nil, min_altitude: nil, max_altitude_msl: nil}, _facts, _context), do: :ok
  def check(_policy, %{ends_flight?: true}, _context), do: :ok

  def check(policy, facts, context) do
    case FlightPath.heights(facts, context) do
      {:ok, heights} -> Enum.find_value(heights, :ok, &refused(policy, facts, &1, context))
      {:unknown, why} -> Refusal.deny(:heights_unknown, command: Intent.label(facts), unknown: why)
    end
  end

  defp refused(policy, facts, {home, msl, given}, context) do
    floor = floor(policy, facts)

    started =
      for datum <- context.datums,
          msl != nil,
          {limit, side} <- [{policy.max_altitude, :max}, {floor, :min}],
          do: {limit, side, msl - datum, "above where it took off"}

    limits = [
      {policy.max_altitude, :max, home, "above home"},
      {floor, :min, home, "above home"},
      {policy.max_altitude_msl, :max, msl, "above mean sea level"}
      | started
    ]

    Enum.find_value(limits, fn {limit, side, height, above} ->
      (limit != nil and not within?(side, height, limit)) &&
        beyond(facts.what, "#{bound(side)} #{metres(limit)}", above, height, given)
    end)
  end

  # A stored place (a home, a landing place) may be on the ground.
  defp floor(_policy, %{path: {kind, _places}}) when kind in [:at, :along, :level], do: nil
  defp floor(_policy, %{path: {:from, _start, _place}}), do: nil
  defp floor(policy, _facts), do: policy.min_altitude

  defp within?(_side, nil, _limit), do: false
  defp within?(:max, height, limit), do: height <= limit
  defp within?(:min, height, limit), do: height >= limit

  defp beyond(place, limit, above, nil, given),
    do: Refusal.deny(:height_unknown, place: place, limit: limit, above: above, unknown: unknown(given))

  defp beyond(place, limit, above, height, _given),
    do: Refusal.deny(:height, place: place, height: metres(height), above: above, limit: limit)

  defp unknown(:terrain), do: Refusal.text(:above_ground)
  defp unknown(:own), do: Refusal.text(:own_height)
  defp unknown(_home_or_msl), do: Refusal.text(:home_height)

  defp bound(:max), do: "at most"
  defp bound(:min), do: "at least"

  defp metres(value) when is_integer(value), do: "#{value} m"

  defp metres(value),
    do: "#{value |> Float.round(1) |> Aerie.Base.Json.encode!() |> String.replace_suffix(".0", "")} m"
end
