defmodule Aerie.Incident.Records do
  @moduledoc """
  Reads the audit log and the ledger of a gateway from their folders, whether it runs or not. Nothing is written there, and no process
  is asked.
  """

  alias Aerie.Base.Segments.Segment
  alias Aerie.Control.Ledger.Journal
  alias Aerie.Control.Policy.Audit.{Chain, Record}
  alias Aerie.Incident.Span

  # Decisions of commands that ended within the span, and may have begun before it.
  @before_us 20 * 60 * 1_000_000
  @max_records 50_000
  @max_commands 100_000

  @typedoc "A record of the audit log: its time, its fields, and its line."
  @type entry :: %{at: integer(), fields: %{String.t() => term()}, line: String.t()}

  @doc """
  The records about a vehicle and about the gateway as a whole, of a span and twenty minutes before it. The lines are those of the log, so
  that each one's hash can be checked.
  """
  @spec audit(Path.t(), String.t(), Span.t()) :: {[entry()], notes :: [String.t()]}
  def audit(dir, vehicle, span) do
    case Chain.files(dir) do
      {:ok, %{segments: []}} -> {[], ["there is no audit log in #{dir}"]}
      {:ok, %{segments: segments}} -> segments(segments, vehicle, span)
      {:error, :enoent} -> {[], ["there is no audit log: #{dir} does not exist"]}
      {:error, reason} -> {[], ["audit log: #{dir}: #{:file.format_error(reason)}"]}
    end
  end

  defp segments(segments, vehicle, span) do
    state = %{records: [], count: 0, damaged: 0, over: 0, notes: []}

    state =
      segments
      |> Enum.filter(&recent?(&1, span))
      |> Enum.reduce(state, fn segment, state ->
        case Segment.fold(segment, &Segment.line/1, state, &line(&1, &2, vehicle, span)) do
          {:ok, _segment, _ending, state} -> state
          {:error, reason} -> add(state, "audit log: #{segment.path}: #{:file.format_error(reason)}")
        end
      end)

    state =
      if state.damaged > 0, do: add(state, "audit log: #{state.damaged} lines were changed"), else: state

    state = if state.over > 0, do: add(state, "audit log: #{state.over} further records"), else: state
    {Enum.reverse(state.records), state.notes}
  end

  defp add(state, note), do: %{state | notes: [note | state.notes]}

  # Written to the last time before the span begins: it has nothing of it.
  defp recent?(segment, span) do
    case File.stat(segment.path, time: :posix) do
      {:ok, %{mtime: written}} -> (written + 1) * 1_000_000 >= span.from - @before_us
      _gone -> false
    end
  end

  defp line(line, state, vehicle, span) do
    with {:ok, %{fields: fields}} <- Record.decode(line),
         at when at != nil <- Span.read(fields["at"]) do
      cond do
        at < span.from - @before_us or at > span.to or fields["vehicle"] not in [nil, vehicle] -> state
        state.count >= @max_records -> %{state | over: state.over + 1}
        true -> keep(state, %{at: at, fields: fields, line: line})
      end
    else
      _changed -> %{state | damaged: state.damaged + 1}
    end
  end

  defp keep(state, record), do: %{state | records: [record | state.records], count: state.count + 1}

  @doc "The ledger's entries that were received or ended within a span and twenty minutes before it, by their ids."
  @spec ledger(Path.t(), Span.t()) :: {%{String.t() => map()}, notes :: [String.t()]}
  def ledger(dir, span) do
    since = span.from - @before_us

    case File.exists?(Journal.path(dir)) && Journal.fold(dir, %{}, &entry(&1, &2, since, span.to)) do
      false -> {%{}, ["there is no ledger in #{dir}"]}
      {:ok, entries, 0} -> {entries, []}
      {:ok, entries, damaged} -> {entries, ["ledger: #{damaged} lines are damaged"]}
      {:error, text} -> {%{}, ["ledger: #{text}"]}
    end
  end

  defp entry(["new", id, _digest, at, envelope], entries, since, to)
       when is_integer(at) and at >= since and at <= to and map_size(entries) < @max_commands,
       do: Map.put(entries, id, %{"envelope" => envelope, "received_at" => at})

  defp entry([what, id, at | more], entries, _since, _to) when is_map_key(entries, id) and is_integer(at),
    do: Map.update!(entries, id, &step(&1, what, at, more))

  # Not sent before the gateway was stopped; kept here, because the request was made.
  defp entry(["gone", id], entries, _since, _to) when is_map_key(entries, id),
    do: put_in(entries[id]["gone"], true)

  defp entry(_other, entries, _since, _to), do: entries

  defp step(entry, "sent", at, _more), do: Map.put(entry, "sent_at", at)

  defp step(entry, "interrupted", at, _more),
    do: Map.merge(entry, %{"result" => "unknown", "done_at" => at, "interrupted" => true})

  defp step(entry, "done", at, [status, reason, details]) do
    Map.merge(entry, %{
      "result" => status,
      "done_at" => at,
      "result_reason" => reason,
      "details" => details
    })
  end

  defp step(entry, _other, _at, _more), do: entry
end
