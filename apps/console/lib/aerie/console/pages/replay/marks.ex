defmodule Aerie.Console.Pages.Replay.Marks do
  @moduledoc """
  What happened, as marks on the time line: events of the fleet by severity, and commands with their decisions from the
  audit log, which is for operators.
  """

  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet

  @max 1_000
  @page 1_000
  @max_pages 20

  @typedoc "`kind`: critical, warning, landed, done, refused. `at`: unix seconds. `who`, `rule`: of a command."
  @type mark :: %{
          required(:at) => float(),
          required(:kind) => String.t(),
          required(:vehicle) => String.t() | nil,
          required(:text) => String.t(),
          optional(atom()) => term()
        }

  @doc "The marks of a span (unix microseconds), the oldest first, the newest #{@max}; and notes on what is missing."
  @spec read(term(), Roles.source(), from :: integer(), to :: integer()) :: {[mark()], notes :: [String.t()]}
  def read(gateway, user, from, to) do
    %{events: events, cut: cut, problem: problem} = Fleet.Bridge.past_events(gateway, from, to)
    commands = commands(gateway, user, from, to)
    marks = Enum.flat_map(events, &event/1) ++ commands
    shown = marks |> Enum.sort_by(& &1.at, :desc) |> Enum.take(@max) |> Enum.reverse()

    {shown,
     for(
       {true, text} <- [
         {problem != nil, "Events of earlier runs are missing: #{problem}"},
         {cut > 0 or length(marks) > @max, "Only the newest #{@max} marks are shown"},
         {not Roles.at_least?(user.role, :operator), "Commands are shown to operators"}
       ],
       do: text
     )}
  end

  @doc "The mark of an event, if it has one."
  @spec event(map()) :: [mark()]
  def event(event) do
    %{severity: severity, text: text} = Fleet.describe_event(event)

    case kind(event.type, severity) do
      nil -> []
      kind -> [%{at: seconds(event.time), kind: kind, vehicle: event.vehicle, text: text}]
    end
  end

  defp kind("landed", _severity), do: "landed"
  defp kind(_type, severity) when severity <= 3, do: "critical"
  defp kind(_type, 4), do: "warning"
  defp kind(_type, _severity), do: nil

  @doc "The marks of the commands of a span (unix microseconds), newest first; none for those who may not see them."
  @spec commands(term(), Roles.source(), from :: integer(), to :: integer()) :: [mark()]
  def commands(gateway, user, from, to) do
    with true <- Roles.at_least?(user.role, :operator),
         {:ok, %{dir: dir}} <- Audit.status(gateway) do
      dir |> records(from, nil, @max_pages, []) |> marks(to)
    else
      _none -> []
    end
  end

  # By the log's own index, from the newest back to the span's beginning.
  defp records(_dir, _from, _before, 0, found), do: found

  defp records(dir, from, before, pages, found) do
    with {:ok, %{records: [_ | _] = records, next: next}} <- Audit.page(dir, %{before: before, limit: @page}) do
      {within, older} = Enum.split_while(records, &(time(&1) >= from))
      found = found ++ within
      if older != [] or next == nil, do: found, else: records(dir, from, next, pages - 1, found)
    else
      _none -> found
    end
  end

  defp time(record) do
    case DateTime.from_iso8601(record["at"] || "") do
      {:ok, time, _offset} -> DateTime.to_unix(time, :microsecond)
      _unknown -> 0
    end
  end

  @doc "The marks of records of the audit log, newest first: a refusal, or a result with the time that it took."
  @spec marks([map()], to :: integer()) :: [mark()]
  def marks(records, to) do
    begun =
      for %{"type" => "decision", "id" => id} = record when is_binary(id) <- records,
          into: %{},
          do: {id, time(record)}

    for record <- records, time(record) <= to, mark = mark(record, begun), mark != nil, do: mark
  end

  defp mark(%{"decision" => "deny", "command" => command} = record, _begun) when is_binary(command),
    do: mark(record, "refused", "#{command} refused: #{record["reason"]}", %{rule: record["rule"]})

  defp mark(%{"type" => "result", "command" => command, "result" => result} = record, begun)
       when is_binary(command) do
    took = with at when at != nil <- begun[record["id"]], do: div(time(record) - at, 1000)
    good? = result in ["completed", "accepted"]
    reason = if record["reason"], do: ": #{record["reason"]}", else: ""
    mark(record, if(good?, do: "done", else: "refused"), "#{command} #{result}#{reason}", %{took_ms: took})
  end

  defp mark(_other, _begun), do: nil

  defp mark(record, kind, text, more) do
    Map.merge(more, %{
      at: seconds(time(record)),
      kind: kind,
      vehicle: record["vehicle"],
      text: text,
      who: record["source"],
      record: record["n"]
    })
  end

  defp seconds(us), do: Float.round(us / 1_000_000, 1)
end
