defmodule Aerie.Vehicle.Events.Detector.Budget do
  @quiet_us 2_000_000
  @summary_us 10_000_000

  @moduledoc """
  How many events of each kind a vehicle may have, so that a script or an attacker with three thousand messages a second cannot
  push what matters out of the stream. A pure value.

  Each kind has a token bucket of its own: no number of texts suppresses `armed`, chatter suppresses no urgent text, and
  the vehicle's parts suppress no text of its autopilot.

  | kind                                             | burst   | a second |
  |--------------------------------------------------|---------|----------|
  | texts of severity 0 to 2 (emergency to critical) | 60      | 2        |
  | texts of severity 3 and 4 (error, warning)       | 60      | 2        |
  | all other texts                                  | 60      | 2        |
  | texts of all parts of the vehicle, like the three above | 60 | 2      |
  | `param_changed` (a whole file may be loaded)     | 2000    | 20       |
  | every other type                                 | 60      | 2        |

  Events over the budget are counted and reported as one `events.suppressed`: #{div(@quiet_us, 1_000_000)} s after the last one of them, or every
  #{div(@summary_us, 1_000_000)} s while they go on.
  """

  # More than any healthy vehicle sends all the time, and more than any sends when it boots.
  @usual %{burst: 60, interval_us: 500_000}
  @params %{burst: 2_000, interval_us: 50_000}
  # Frames of two links may be a little out of order; a bucket that is emptier than this was used under another clock.
  @slack_us 60_000_000

  defstruct due: %{}, over: %{}, suppressed: 0

  @typedoc """
  `due`: when each kind's bucket is full again (unix us); `over`: what is to be reported; `suppressed`: how many in all.
  """
  @type t :: %__MODULE__{due: %{kind() => integer()}, over: %{kind() => map()}, suppressed: non_neg_integer()}
  @typedoc "A type of event, texts by their urgency. The number of types bounds the tables."
  @type kind :: String.t() | {String.t(), :urgent | :warning | :other, part? :: boolean()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Whether an event that the gateway learned of `at` this time is within the budget; if not, it is counted."
  @spec take(t(), type :: String.t(), data :: map(), at :: integer()) :: {:ok | :over, t()}
  def take(budget, type, data, at) do
    kind = kind(type, data)
    %{burst: burst, interval_us: interval} = rate(type)
    capacity = burst * interval

    due =
      case budget.due do
        %{^kind => due} when due - at <= capacity + @slack_us -> max(due, at)
        _never_or_another_clock -> at
      end

    if due + interval - at <= capacity,
      do: {:ok, %{budget | due: Map.put(budget.due, kind, due + interval)}},
      else: {:over, count(budget, kind, type, data, at)}
  end

  defp count(budget, kind, type, data, at) do
    one = %{type: type, count: 0, first: at}
    over = Map.get(budget.over, kind, one)
    over = Map.merge(over, %{count: over.count + 1, last: at, data: data})
    %{budget | over: Map.put(budget.over, kind, over), suppressed: budget.suppressed + 1}
  end

  @doc "The data of each `events.suppressed` that is due `at` this time."
  @spec summaries(t(), at :: integer()) :: {t(), [map()]}
  def summaries(%{over: over} = budget, _at) when over == %{}, do: {budget, []}

  def summaries(budget, at) do
    {ready, over} = Enum.split_with(budget.over, fn {_kind, one} -> ready?(one, at) end)
    {%{budget | over: Map.new(over)}, for({_kind, one} <- Enum.sort(ready), do: data(one))}
  end

  # The last condition: a clock was set back.
  defp ready?(one, at),
    do: at - one.last >= @quiet_us or at - one.first >= @summary_us or at < one.first - @slack_us

  defp data(one) do
    %{
      "of" => one.type,
      "count" => one.count,
      "first" => Aerie.Base.Json.time(one.first),
      "last" => Aerie.Base.Json.time(one.last),
      "last_data" => one.data,
      "text" => "#{one.count} more #{noun(one.type, one.count)}"
    }
  end

  defp noun("statustext", 1), do: "text"
  defp noun("statustext", _count), do: "texts"
  defp noun(type, _count), do: type

  defp kind("statustext", %{"severity" => severity} = data),
    do: {"statustext", urgency(severity), is_map_key(data, "component")}

  defp kind(type, _data), do: type

  defp urgency(severity) when severity <= 2, do: :urgent
  defp urgency(severity) when severity <= 4, do: :warning
  defp urgency(_severity), do: :other

  defp rate("param_changed"), do: @params
  defp rate(_type), do: @usual
end
