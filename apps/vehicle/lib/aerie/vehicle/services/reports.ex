defmodule Aerie.Vehicle.Services.Reports do
  @text_us 1_500_000

  @moduledoc """
  EVENT messages of a vehicle's components (X3), with which PX4 reports why it does what it does, even while there is no
  ground station to send texts to. A pure value.

  An event has an id in hexadecimal, a level for users (external), a level for the log (internal), and the bytes of its
  arguments. Its name and the values of its arguments come from a file that the vehicle serves (`define/2`), otherwise from
  `Reports.Names`. The texts in that file are not read.

  Most events also come as a STATUSTEXT, which then ends with a tab (`doubled`), a moment before or after. Those are reported
  once, as the text: an event waits #{@text_us / 1_000_000} s for its text, and is reported if none comes. `show/1` has all of them. Events
  that are not for display (levels above 7) or not for us only count in the sequence. The reasons that keep a vehicle from
  being armed are collected in one list (`Reports.Checks`).
  """

  import Bitwise

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Services.Reports.{Checks, Definitions, Names, Sequence}
  alias MavCodec.Enums.MavEventCurrentSequenceFlags, as: EventSequenceFlags
  alias MavCodec.Messages.{CurrentEventSequence, Event, RequestEvent, ResponseEventError}

  # A text whose event was lost and requested again waits longer.
  @late_us 6_000_000
  @max_components 8
  @max_waiting 64
  @recent 16
  @reset EventSequenceFlags.value(:MAV_EVENT_CURRENT_SEQUENCE_FLAGS_RESET)

  defstruct components: %{}, open: [], texts: [], recent: [], own: Definitions.none(), asked?: false

  @typedoc """
  `severity`, `internal`: 0 emergency to 7 debug; `arguments`: the bytes without trailing zeros; `values`: their meaning, nil if
  unknown.
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
  @typedoc "`own`: what the vehicle itself says about its events; `asked?`: whether that was read since its boot."
  @type t :: %__MODULE__{}
  @typedoc """
  `:new`: a report that has just come; `:report`: one without a text; `:checks`: all that keeps the vehicle from being armed.
  """
  @type output :: {:new, report()} | {:report, report()} | {:checks, [report()]}
  @type own :: {system :: non_neg_integer(), component :: non_neg_integer()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "Sets the vehicle's own event definitions (`Names.own/1`); `Definitions.none/0` if it has none."
  @spec define(t(), Definitions.t()) :: t()
  def define(reports, own), do: %{reports | own: own}

  @doc "The vehicle was restarted, maybe with another firmware: what it says about its events is to be read again."
  @spec rebooted(t()) :: t()
  def rebooted(reports), do: %{reports | asked?: false}

  @doc """
  EVENT, CURRENT_EVENT_SEQUENCE or RESPONSE_EVENT_ERROR of a component. `own`: our ids. `sure?`: certainly not of another
  vehicle with the same id; otherwise a sequence number far from the last one does not mean that events are missing.
  """
  @spec message(t(), 0..255, struct(), own(), integer(), sure? :: boolean()) :: {t(), [output()]}
  def message(reports, component, message, own, at, sure? \\ true)

  def message(%{components: known} = reports, component, _message, _own, _at, _sure?)
      when not is_map_key(known, component) and map_size(known) >= @max_components,
      do: {reports, []}

  def message(reports, component, %Event{} = message, own, at, false) do
    if Sequence.near?(component(reports, component).sequence, message.sequence) do
      message(reports, component, message, own, at, true)
    else
      report = read(reports, component, message, at)
      {if(for_us?(message, own) and report.severity <= 7, do: pair(reports, report), else: reports), []}
    end
  end

  def message(reports, _component, _message, _own, _at, false), do: {reports, []}

  def message(reports, component, %CurrentEventSequence{} = message, _own, at, true) do
    reset? = (message.flags &&& @reset) != 0
    {sequence(reports, component, &Sequence.current(&1, message.sequence, reset?, at)), []}
  end

  # The answer to another program's request tells us the same.
  def message(reports, component, %ResponseEventError{} = message, _own, _at, true),
    do: {sequence(reports, component, &Sequence.gone(&1, message.sequence_oldest_available)), []}

  def message(reports, component, %Event{} = message, own, at, true) do
    state = component(reports, component)
    {verdict, sequence} = Sequence.event(state.sequence, message.sequence, message.event_time_boot_ms, at)
    reports = put_component(reports, component, %{state | sequence: sequence})

    if verdict == :new and for_us?(message, own),
      do: event(reports, component, read(reports, component, message, at)),
      else: {reports, []}
  end

  defp event(reports, component, report) do
    state = component(reports, component)
    {what, checks, list} = Checks.event(state.checks, report.sequence, report.name, report, report.at)
    reports = put_component(reports, component, %{state | checks: checks})
    outputs = [{:new, report}] ++ if(list, do: [{:checks, list}], else: [])
    if what == :other and report.severity <= 7, do: {pair(reports, report), outputs}, else: {reports, outputs}
  end

  # The text came first, or may still come.
  defp pair(reports, report) do
    case Enum.split_while(reports.texts, &(&1.source != report.component)) do
      {before, [text | rest]} ->
        keep(%{reports | texts: before ++ rest}, %{report | text: text.text})

      {_all, []} ->
        %{reports | open: Enum.take(reports.open ++ [report], -@max_waiting)}
    end
  end

  @doc "A complete STATUSTEXT (`Protocols.StatusText`)."
  @spec text(t(), map()) :: t()
  # A component without events has no texts that double them.
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
  The reports whose texts did not come until `now`, those of a component in its own order. While events that were requested
  are missing, later ones wait for them, at most #{@late_us / 1_000_000} s.
  """
  @spec expire(t(), integer()) :: {t(), [output()]}
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

  # A report never comes before an earlier one of its component.
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

  @doc "Whether events are missing."
  @spec missing?(t()) :: boolean()
  def missing?(%{components: components}) when components == %{}, do: false

  def missing?(%{components: components}),
    do: Enum.any?(components, fn {_component, %{sequence: sequence}} -> Sequence.waiting?(sequence) end)

  @doc "The requests to a vehicle's components that are due at `now`."
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

  @doc "Time goes on from `now`, which is not comparable with the time before: what waits is due at once."
  @spec rebased(t(), integer()) :: t()
  def rebased(reports, now) do
    components =
      Map.new(reports.components, fn {component, state} ->
        {component, %{state | sequence: Sequence.rebased(state.sequence, now), checks: nil}}
      end)

    %{reports | components: components, texts: [], open: Enum.map(reports.open, &%{&1 | at: now - @text_us})}
  end

  @report Object.fields([
            {:time, :time, nil, "when the gateway received it", :at},
            {:time_boot_ms, :integer, "ms", "the vehicle's clock when it was sent", :boot_ms},
            {:component, :integer, nil, "component that sent it"},
            {:sequence, :integer, nil, "number of the report"},
            {:id, :text, nil, "id of the report, hexadecimal"},
            {:name, :text, nil, "name of the report, if it is known"},
            {:severity, :integer, nil, "MAV_SEVERITY for users"},
            {:internal_severity, :integer, nil, "MAV_SEVERITY for the log", :internal},
            {:arguments, :text, nil, "its arguments, hexadecimal"},
            {:values, {:list, :any}, nil, "their values, if they are known"},
            {:text, :text, nil, "a sentence for people, if the report is known"}
          ])
  @fields Object.fields([
            {:lost, :integer, nil, "how many were lost"},
            {:recent, {:list, {:object, @report}}, nil, "the last #{@recent}, newest first:"}
          ])

  @doc "What people are shown of `show/1`."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc "For the snapshot: the last #{@recent} reports, newest first, and how many events were lost."
  @spec show(t()) :: %{recent: [map()], lost: non_neg_integer()}
  def show(reports) do
    lost = for {_component, %{sequence: sequence}} <- reports.components, do: sequence.lost
    %{recent: Enum.map(reports.recent, &Map.merge(&1, hex(&1))), lost: Enum.sum(lost)}
  end

  @doc "A report's id and arguments in hexadecimal."
  @spec hex(report()) :: %{id: String.t(), arguments: String.t()}
  def hex(report) do
    %{
      id: "0x" <> (report.id |> Integer.to_string(16) |> String.pad_leading(8, "0")),
      arguments: Base.encode16(report.arguments, case: :lower)
    }
  end

  defp read(%{own: own}, component, message, at) do
    %{
      component: component,
      sequence: message.sequence,
      id: message.id,
      name: Names.name(own, message.id),
      severity: message.log_levels &&& 15,
      internal: message.log_levels >>> 4,
      arguments: String.trim_trailing(message.arguments, <<0>>),
      values: Names.values(own, message.id, message.arguments),
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
