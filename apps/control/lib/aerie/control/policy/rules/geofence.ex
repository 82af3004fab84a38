defmodule Aerie.Control.Policy.Rules.Geofence do
  @moduledoc "What a command names must be inside the fence, and so must the straight way of the vehicle to it (`Aerie.Control.Policy.Fence`)."

  @behaviour Aerie.Control.Policy.Rules.Rule

  alias Aerie.Control.Policy.{Fence, FlightPath, Intent}
  alias Aerie.Vehicle.Command.Refusal

  @impl Aerie.Control.Policy.Rules.Rule
  def check(%{fence: nil}, _facts, _context), do: :ok
  def check(_policy, %{ends_flight?: true}, _context), do: :ok

  def check(policy, facts, context) do
    case FlightPath.judged(facts, context) do
      {:ok, readings} ->
        targets =
          for legs <- readings,
              target <-
                if(length(legs) > 1, do: numbered(legs, facts), else: for(leg <- legs, do: {leg, facts.what})),
              do: target

        Enum.find_value(targets, :ok, &refused(policy.fence, &1, facts.sweep, context))

      {:unknown, why} ->
        Refusal.deny(:place_unknown, command: Intent.label(facts), unknown: why)
    end
  end

  defp numbered(legs, %{path: {kind, _}} = facts) when kind not in [:to, :along, :at],
    do: for(leg <- legs, do: {leg, facts.what})

  defp numbered(legs, %{path: {_kind, _, _}} = facts), do: for(leg <- legs, do: {leg, facts.what})
  defp numbered(legs, facts), do: for({leg, n} <- Enum.with_index(legs, 1), do: {leg, "#{facts.what} #{n}"})

  defp refused(fence, {{from, to, _given} = leg, what}, sweep, context) do
    room = FlightPath.room(leg, sweep, context)
    higher = FlightPath.raised(to, room.climb)

    with :ok <- Fence.check_position(fence, to, what),
         :ok <- if(from, do: Fence.check_way(fence, from, to, "the straight way to #{what}"), else: :ok),
         :ok <- Fence.check_room(fence, bent(sweep, from), to, room, what),
         :ok <-
           if(room.climb > 0,
             do: Fence.check_position(fence, higher, "an aborted landing at #{what}"),
             else: :ok
           ) do
      nil
    end
  end

  # A spline leaves the straight way.
  defp bent(:curve, %{} = from), do: from
  defp bent(_straight, _from), do: nil
end
