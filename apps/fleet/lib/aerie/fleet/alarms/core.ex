defmodule Aerie.Fleet.Alarms.Core do
  @most 200

  @moduledoc """
  The alarms of a gateway. A pure value.

  A *condition* is something that is wrong now. Each source tells all of its conditions at once (`put/4`): snapshots,
  the diagnosis, and what the vehicles' detectors made of their events (`Aerie.Fleet.Alarms.Detected`). So the end of a
  condition needs no message that could be lost. Each condition has a key, so it is one alarm however often it comes.

  An alarm goes through these states:

  | | not acknowledged | acknowledged |
  |---|---|---|
  | the condition holds | `:active`: sounds | `:acknowledged` |
  | it is over | `:over`: stays in the list, does not sound | removed |

  So nothing disappears before somebody has seen it. At most #{@most} alarms are kept. Beyond that, alarms that are over are dropped first,
  then the least severe and oldest; `dropped` counts them.
  """

  @severities [:critical, :warning, :notice]
  @rank @severities |> Enum.with_index() |> Map.new()

  defstruct alarms: %{}, dropped: 0, next: 1

  @type severity :: :critical | :warning | :notice
  @typedoc "The kind of condition, and the vehicle, link or other subject that it concerns."
  @type key :: {kind :: atom(), subject :: term()}
  @typedoc """
  `:vehicle` is the one that it is about, and its page's name; the text does not name it again.
  `:why` and `:mend` are sentences of what shows it, and of what to do. `:since`: if that is not now.
  """
  @type condition :: %{
          :key => key(),
          :severity => severity(),
          :text => String.t(),
          :vehicle => String.t() | nil,
          optional(:why) => String.t() | nil,
          optional(:mend) => String.t() | nil,
          optional(:since) => integer()
        }
  @type alarm :: %{
          id: String.t(),
          key: key(),
          severity: severity(),
          text: String.t(),
          vehicle: String.t() | nil,
          why: String.t() | nil,
          mend: String.t() | nil,
          source: term(),
          since: integer(),
          over: integer() | nil,
          by: String.t() | nil
        }
  @type state :: :active | :acknowledged | :over
  @type t :: %__MODULE__{alarms: %{key() => alarm()}, dropped: non_neg_integer(), next: pos_integer()}

  @doc "No alarm."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Sets all conditions of a source at `now` (unix microseconds). Conditions that the source no longer names are over."
  @spec put(t(), source :: term(), [condition()], integer()) :: t()
  def put(%__MODULE__{} = alarms, source, conditions, now) do
    keys = MapSet.new(conditions, & &1.key)

    gone =
      for {key, %{source: ^source, over: nil}} <- alarms.alarms, not MapSet.member?(keys, key), do: key

    alarms = Enum.reduce(gone, alarms, &clear(&2, &1, now))
    Enum.reduce(conditions, alarms, &raise_alarm(&2, source, &1, now))
  end

  @doc "Begins a condition at `now`. One that holds already keeps its time; one that got worse has to be acknowledged again."
  @spec raise_alarm(t(), source :: term(), condition(), integer()) :: t()
  def raise_alarm(%__MODULE__{} = alarms, source, %{key: key} = condition, now) do
    since = Map.get(condition, :since, now)

    case alarms.alarms do
      %{^key => %{over: nil} = alarm} ->
        worse? = @rank[condition.severity] < @rank[alarm.severity]
        kept = Map.merge(alarm, Map.take(condition, [:severity, :text, :why, :mend]))
        store(alarms, if(worse?, do: %{kept | by: nil, since: since}, else: kept))

      _new_or_again ->
        alarm =
          Map.merge(%{why: nil, mend: nil}, condition)
          |> Map.merge(%{id: "a#{alarms.next}", source: source, since: since, over: nil, by: nil})

        %{alarms | next: alarms.next + 1} |> store(alarm) |> bound()
    end
  end

  @doc "Ends a condition."
  @spec clear(t(), key(), integer()) :: t()
  def clear(%__MODULE__{} = alarms, key, now) do
    case alarms.alarms do
      %{^key => %{over: nil, by: nil} = alarm} -> store(alarms, %{alarm | over: now})
      %{^key => %{over: nil}} -> %{alarms | alarms: Map.delete(alarms.alarms, key)}
      _none -> alarms
    end
  end

  @doc "Records that `by` has seen the alarms with these ids, or `:all`. Those that are over are removed."
  @spec acknowledge(t(), [String.t()] | :all, by :: String.t()) :: t()
  def acknowledge(%__MODULE__{} = alarms, ids, by) do
    seen? = fn alarm -> ids == :all or alarm.id in ids end

    kept =
      for {key, alarm} <- alarms.alarms, not (alarm.over != nil and seen?.(alarm)), into: %{} do
        {key, if(alarm.by == nil and seen?.(alarm), do: %{alarm | by: by}, else: alarm)}
      end

    %{alarms | alarms: kept}
  end

  @doc "The state of an alarm."
  @spec state(alarm()) :: state()
  def state(%{over: over}) when over != nil, do: :over
  def state(%{by: by}) when by != nil, do: :acknowledged
  def state(_alarm), do: :active

  @doc "All alarms: those not acknowledged first, then by severity, the newest first."
  @spec list(t()) :: [alarm()]
  def list(%__MODULE__{alarms: alarms}), do: alarms |> Map.values() |> Enum.sort_by(&order/1)

  defp order(alarm), do: {state_rank(state(alarm)), @rank[alarm.severity], -alarm.since, alarm.id}

  defp state_rank(:active), do: 0
  defp state_rank(:over), do: 1
  defp state_rank(:acknowledged), do: 2

  @typedoc """
  What every page shows: the number of active alarms by severity, how many nobody has seen yet, the first of `list/1`, and the severity
  that sounds.
  """
  @type summary :: %{
          counts: %{severity() => non_neg_integer()},
          waiting: non_neg_integer(),
          first: alarm() | nil,
          sound: severity() | nil
        }

  @doc "The summary for the header of the pages."
  @spec summary(t()) :: summary()
  def summary(%__MODULE__{} = alarms) do
    list = list(alarms)
    active = Enum.filter(list, &(&1.over == nil))
    sounding = for %{by: nil, severity: severity} <- active, severity != :notice, do: severity

    %{
      counts:
        Map.new(@severities, fn severity -> {severity, Enum.count(active, &(&1.severity == severity))} end),
      waiting: Enum.count(list, &(&1.by == nil)),
      first: List.first(list),
      sound: Enum.min_by(sounding, &@rank[&1], fn -> nil end)
    }
  end

  defp store(alarms, alarm), do: %{alarms | alarms: Map.put(alarms.alarms, alarm.key, alarm)}

  defp bound(%{alarms: alarms} = state) when map_size(alarms) <= @most, do: state

  defp bound(%{alarms: alarms} = state) do
    least =
      alarms
      |> Map.values()
      |> Enum.max_by(&{&1.over != nil, @rank[&1.severity], -&1.since, &1.id})

    %{state | alarms: Map.delete(alarms, least.key), dropped: state.dropped + 1}
  end
end
