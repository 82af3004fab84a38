defmodule Aerie.Vehicle.Events.Detector.OfflineChanges do
  @moduledoc """
  What changed while the gateway was not running: mode, armed and in the air, as they were published before the restart,
  compared with what they are now. Pure.

  Each is compared once, when it is first known again. A difference is an event with `found: true` and `since`, the time at
  which the old value still held; when it changed after that, and how often, is not known. A value that is unknown, or was
  published too long ago, gives no event.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Events.Detector.Step

  @keys [:mode, :armed, :in_air]
  # After an hour it is another flight, not an interruption of this one.
  @max_age_us 3_600_000_000
  # Running clocks are corrected by up to this much.
  @ahead_us 5_000_000

  @typedoc "What was published last and is not compared yet; `since` in unix microseconds."
  @type t ::
          %{
            optional(:mode) => String.t(),
            optional(:armed) => boolean(),
            optional(:in_air) => boolean(),
            since: integer()
          }
          | nil

  @doc "The keys of a digest that are kept over a restart."
  @spec keys() :: [atom()]
  def keys, do: @keys

  @doc "Compares with what is known now. The steps are in the order in which things happen to a vehicle."
  @spec steps(t(), map(), integer()) :: {t(), [Step.t()]}
  def steps(nil, _now, _at), do: {nil, []}

  def steps(%{since: since}, _now, at) when at - since > @max_age_us or since - at > @ahead_us,
    do: {nil, []}

  def steps(published, now, _at) do
    known = Enum.filter(@keys, &(is_map_key(published, &1) and is_map_key(now, &1)))
    marks = %{"found" => true, "since" => Json.time(published.since)}
    events = for key <- known, differs?(key, published[key], now[key]), do: event(key, published, now)
    left = Map.drop(published, known)

    {if(map_size(left) > 1, do: left),
     for({_order, type, data} <- Enum.sort(events), do: Step.event(type, Map.merge(data, marks)))}
  end

  # A mode that only the vehicle can name is shown as a number until its name is known: it may be the same mode.
  defp differs?(:mode, former, mode), do: former != mode and not Modes.unnamed?(mode)
  defp differs?(_key, former, value), do: former != value

  defp event(:mode, published, now), do: {1, "mode_change", %{"from" => published.mode, "to" => now.mode}}
  defp event(:armed, _published, %{armed: true} = now), do: {2, "armed", mode(now)}
  defp event(:in_air, _published, %{in_air: true} = now), do: {3, "takeoff", mode(now)}
  defp event(:in_air, _published, now), do: {4, "landed", mode(now)}
  defp event(:armed, _published, now), do: {5, "disarmed", mode(now)}

  defp mode(now), do: %{"mode" => now[:mode]}
end
