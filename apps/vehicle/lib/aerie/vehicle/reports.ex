defmodule Aerie.Vehicle.Reports do
  @moduledoc """
  What a vehicle's components report with EVENT messages (X3): PX4 says with them why it does what it does, also while no
  ground station is there to whom it would send texts. A pure value.

  An event has an id, arguments and two log levels; its words are in a file of the firmware. Shown is what is known without
  it: the id in hexadecimal, its name and the values of its arguments if `Reports.Names` has them, the level meant for people
  (external), the one meant for the log (internal), the arguments as they came.

  Most events come as a STATUSTEXT, too, which then ends with a tab (`doubled`), a moment before or after. Those are shown
  once, as the text: an event waits #{1.5} s for its text and is given when none came. Either way it is in `show/1`. Events
  that are not for display (levels above 7) or not for us are only counted in the sequence, and the reasons that keep a
  vehicle from being armed are given as one list (`Reports.Checks`).
  """

  import Bitwise

  alias Aerie.Vehicle.Reports.{Checks, Names, Sequence}
  alias MavCodec.Messages.{CurrentEventSequence, Event, RequestEvent, ResponseEventError}

  @text_us 1_500_000
  # A text whose event is lost and asked for again waits longer.
  @late_us 6_000_000
  @max_components 8
  @max_waiting 64
  @recent 16
  @reset 1

  defstruct components: %{}, open: [], texts: [], recent: []

  @typedoc """
  `severity`, `internal`: 0 emergency to 7 debug; `arguments`: as sent, without the zeros at their end; `values`: what they
  mean, nil where that is not known.
  """
  @type report :: %{
          component: 0..255,
          sequence: 0..65_535,
          id: non_neg_integer(),
          name: String.t() | nil,
          severity: 0..15,
          internal: 0..15,
          arguments: binary(),
          values: [Names.value()] | nil,
          text: String.t() | nil,
          at: integer(),
          boot_ms: non_neg_integer()
        }
  @type t :: %__MODULE__{}
  @typedoc "A report at once; one that no text doubles; all that keeps the vehicle from being armed."
  @type given :: {:said, report()} | {:report, report()} | {:checks, [report()]}
  @type own :: {system :: non_neg_integer(), component :: non_neg_integer()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  An EVENT, CURRENT_EVENT_SEQUENCE or RESPONSE_EVENT_ERROR of a component that came `at`. `own`: who we are. `sure?`: it is
  no other vehicle with the same id; else a number far from ours says nothing of what is missing.
  """
  @spec message(t(), 0..255, struct(), own(), integer(), sure? :: boolean()) :: {t(), [given()]}
  def message(reports, component, message, own, at, sure? \\ true)

  def message(%{components: known} = reports, component, _message, _own, _at, _sure?)
      when not is_map_key(known, component) and map_size(known) >= @max_components,
      do: {reports, []}

  def message(reports, component, %Event{} = message, own, at, false) do
    if Sequence.near?(component(reports, component).sequence, message.sequence) do
      message(reports, component, message, own, at, true)
    else
      report = read(component, message, at)
      {if(for_us?(message, own) and report.severity <= 7, do: pair(reports, report), else: reports), []}
    end
  end

  def message(reports, _component, _message, _own, _at, false), do: {reports, []}

  def message(reports, component, %CurrentEventSequence{} = message, _own, at, true) do
    reset? = (message.flags &&& @reset) != 0
    {sequence(reports, component, &Sequence.current(&1, message.sequence, reset?, at)), []}
  end

  # An answer to somebody else's request is true for all.
  def message(reports, component, %ResponseEventError{} = message, _own, _at, true),
    do: {sequence(reports, component, &Sequence.gone(&1, message.sequence_oldest_available)), []}

  def message(reports, component, %Event{} = message, own, at, true) do
    state = component(reports, component)
    {verdict, sequence} = Sequence.event(state.sequence, message.sequence, message.event_time_boot_ms, at)
    reports = put_component(reports, component, %{state | sequence: sequence})

    if verdict == :new and for_us?(message, own),
      do: event(reports, component, read(component, message, at)),
      else: {reports, []}
  end

  defp event(reports, component, report) do
    state = component(reports, component)
    {what, checks, list} = Checks.event(state.checks, report.sequence, report.id, report, report.at)
    reports = put_component(reports, component, %{state | checks: checks})
    given = [{:said, report}] ++ if(list, do: [{:checks, list}], else: [])
    if what == :other and report.severity <= 7, do: {pair(reports, report), given}, else: {reports, given}
  end

  # The text came first, or may come.
  defp pair(reports, report) do
    case Enum.split_while(reports.texts, &(&1.source != report.component)) do
      {before, [text | rest]} ->
        keep(%{reports | texts: before ++ rest}, %{report | text: text.text})

      {_all, []} ->
        %{reports | open: Enum.take(reports.open ++ [report], -@max_waiting)}
    end
  end

  @doc "A whole STATUSTEXT (`Aerie.Vehicle.StatusText`) that the vehicle gave."
  @spec text(t(), map()) :: t()
  # Who sends no events sends no texts that double them.
  def text(%{components: components} = reports, %{doubled: true, source: source} = text)
      when is_map_key(components, source) do
    case Enum.split_while(reports.open, &(&1.component != source)) do
      {before, [report | rest]} -> keep(%{reports | open: before ++ rest}, %{report | text: text.text})
      {_all, []} -> %{reports | texts: Enum.take(reports.texts ++ [text], -@max_waiting)}
    end
  end

  def text(reports, _text), do: reports

  defp keep(reports, report), do: %{reports | recent: Enum.take([report | reports.recent], @recent)}

  @doc """
  It is `now`: reports whose texts did not come are given, those of a component in the order in which it made them. Missing
  ones that were asked for are waited for, #{@late_us / 1_000_000} s at most.
  """
  @spec expire(t(), integer()) :: {t(), [given()]}
  def expire(%{components: components} = reports, _now) when components == %{}, do: {reports, []}

  def expire(reports, now) do
    {ready, open} = ready(reports, now)
    texts = Enum.reject(reports.texts, &(&1.at + patience(reports, &1.source) <= now))
    reports = Enum.reduce(ready, %{reports | open: open, texts: texts}, &keep(&2, &1))

    {components, lists} =
      Enum.map_reduce(reports.components, [], fn {component, state}, lists ->
        {checks, list} = Checks.expire(state.checks, now)
        {{component, %{state | checks: checks}}, if(list, do: [{:checks, list} | lists], else: lists)}
      end)

    {%{reports | components: Map.new(components)}, Enum.map(ready, &{:report, &1}) ++ lists}
  end

  # None before an earlier one of its component.
  defp ready(reports, now) do
    {judged, _waiting} =
      reports.open
      |> ordered()
      |> Enum.map_reduce([], fn %{component: component} = report, waiting ->
        if component not in waiting and report.at + patience(reports, component) <= now,
          do: {{:ready, report}, waiting},
          else: {{:open, report}, [component | waiting]}
      end)

    {for({:ready, report} <- judged, do: report), for({:open, report} <- judged, do: report)}
  end

  defp ordered(open) do
    queues = open |> Enum.sort_by(&{&1.boot_ms, &1.sequence}) |> Enum.group_by(& &1.component)

    {ordered, _empty} =
      Enum.map_reduce(open, queues, fn %{component: component}, queues ->
        Map.get_and_update!(queues, component, &{hd(&1), tl(&1)})
      end)

    ordered
  end

  defp patience(reports, component) do
    if Sequence.waiting?(component(reports, component).sequence), do: @late_us, else: @text_us
  end

  @doc "Whether anything is missing."
  @spec missing?(t()) :: boolean()
  def missing?(reports),
    do:
      Enum.any?(reports.components, fn {_component, %{sequence: sequence}} -> Sequence.waiting?(sequence) end)

  @doc "What to ask a vehicle's components for at `now`."
  @spec requests(t(), system :: non_neg_integer(), integer()) :: {t(), [struct()]}
  def requests(reports, system, now) do
    {components, requests} =
      Enum.map_reduce(reports.components, [], fn {component, state}, requests ->
        {sequence, ranges} = Sequence.expire(state.sequence, now)

        asked =
          for {first, last} <- ranges do
            %RequestEvent{
              target_system: system,
              target_component: component,
              first_sequence: first,
              last_sequence: last
            }
          end

        {{component, %{state | sequence: sequence}}, requests ++ asked}
      end)

    {%{reports | components: Map.new(components)}, requests}
  end

  @doc "Time goes on from `now`, whatever it was before: what waits is given with the next `expire/2`."
  @spec rebased(t(), integer()) :: t()
  def rebased(reports, now) do
    components =
      Map.new(reports.components, fn {component, state} ->
        {component, %{state | sequence: Sequence.rebased(state.sequence, now), checks: nil}}
      end)

    %{reports | components: components, texts: [], open: Enum.map(reports.open, &%{&1 | at: now - @text_us})}
  end

  @doc "For the snapshot: the last #{@recent} reports, the newest first, and how many events are lost."
  @spec show(t()) :: %{recent: [map()], lost: non_neg_integer()}
  def show(reports) do
    lost = for {_component, %{sequence: sequence}} <- reports.components, do: sequence.lost
    %{recent: Enum.map(reports.recent, &Map.merge(&1, words(&1))), lost: Enum.sum(lost)}
  end

  @doc "A report's id and arguments in hexadecimal."
  @spec words(report()) :: %{id: String.t(), arguments: String.t()}
  def words(report) do
    %{
      id: "0x" <> (report.id |> Integer.to_string(16) |> String.pad_leading(8, "0")),
      arguments: Base.encode16(report.arguments, case: :lower)
    }
  end

  defp read(component, message, at) do
    %{
      component: component,
      sequence: message.sequence,
      id: message.id,
      name: Names.name(message.id),
      severity: message.log_levels &&& 15,
      internal: message.log_levels >>> 4,
      arguments: String.trim_trailing(message.arguments, <<0>>),
      values: Names.values(message.id, message.arguments),
      text: nil,
      at: at,
      boot_ms: message.event_time_boot_ms
    }
  end

  defp for_us?(message, {system, component}) do
    message.destination_system in [0, system] and message.destination_component in [0, component]
  end

  defp sequence(reports, component, fun) do
    state = component(reports, component)
    put_component(reports, component, %{state | sequence: fun.(state.sequence)})
  end

  defp component(%{components: components}, component) do
    Map.get_lazy(components, component, fn -> %{sequence: Sequence.new(), checks: nil} end)
  end

  defp put_component(reports, component, state),
    do: %{reports | components: Map.put(reports.components, component, state)}
end
