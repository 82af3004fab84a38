defmodule Aerie.Vehicle.Detector.Found do
  @moduledoc """
  What changed while the gateway was not there: the vehicle's mode, whether it is armed and in the air, as they were told last
  before a restart, against what they are found to be. Pure.

  Each is compared once, when it is first known again. A difference is an event marked `found: true`, with `since`, the time at
  which the former value still held: when it changed in between, and how often, nobody saw. What is not known, or was last
  known too long ago, gives no event.
  """

  alias Aerie.Fleet.Json
  alias Aerie.Vehicle.Modes

  @keys [:mode, :armed, :in_air]
  # After an hour it is another flight, not a gap in this one.
  @max_age_us 3_600_000_000
  # Clocks are set by so much while one runs.
  @ahead_us 5_000_000

  @typedoc "What was told last and is not compared yet; `since` in unix microseconds."
  @type t ::
          %{
            optional(:mode) => String.t(),
            optional(:armed) => boolean(),
            optional(:in_air) => boolean(),
            since: integer()
          }
          | nil

  @doc "Which parts of a digest are remembered."
  @spec keys() :: [atom()]
  def keys, do: @keys

  @doc "Compares what is known now; the steps in the order in which things happen to a vehicle."
  @spec steps(t(), map(), integer()) :: {t(), [{String.t(), map(), keyword()}]}
  def steps(nil, _now, _at), do: {nil, []}

  def steps(%{since: since}, _now, at) when at - since > @max_age_us or since - at > @ahead_us,
    do: {nil, []}

  def steps(found, now, _at) do
    known = Enum.filter(@keys, &(is_map_key(found, &1) and is_map_key(now, &1)))
    marks = %{"found" => true, "since" => Json.time(found.since)}
    events = for key <- known, differs?(key, found[key], now[key]), do: event(key, found, now)
    left = Map.drop(found, known)

    {if(map_size(left) > 1, do: left),
     events |> Enum.sort() |> Enum.map(fn {_place, type, data} -> {type, Map.merge(data, marks), []} end)}
  end

  # A mode that only the vehicle has a name for is told by its number until that name is known: it may be the same.
  defp differs?(:mode, former, mode), do: former != mode and not Modes.unnamed?(mode)
  defp differs?(_key, former, value), do: former != value

  defp event(:mode, found, now), do: {1, "mode_change", %{"from" => found.mode, "to" => now.mode}}
  defp event(:armed, _found, %{armed: true} = now), do: {2, "armed", mode(now)}
  defp event(:in_air, _found, %{in_air: true} = now), do: {3, "takeoff", mode(now)}
  defp event(:in_air, _found, now), do: {4, "landed", mode(now)}
  defp event(:armed, _found, now), do: {5, "disarmed", mode(now)}

  defp mode(now), do: %{"mode" => now[:mode]}
end
