defmodule Aerie.Control.Logs.List do
  @moduledoc """
  Lists the logs of a vehicle (LOG_REQUEST_LIST). Pure: `handle(list, event) -> {list, actions}`, with the events and actions of
  `Aerie.Control.Logs.Download`; the end is `{:done, {:ok, [entry]} | {:error, reason}}`.

  Ids begin at 0 (PX4) or 1 (ArduPilot); a vehicle without logs answers with id 0 and num_logs 0 (X1).

  The list is complete with every id that num_logs and last_log_num announce, or with num_logs entries that say
  something. Some vehicles begin with an entry that has neither size nor time and was not announced: it is left out.
  Others announce ids that they do not have (last_log_num 0, or the last id of what was asked); their empty entries
  count when a second question brings no more.
  """

  alias Aerie.Control.Ftp.RoundTrip
  alias MavCodec.Messages, as: M

  @repeats 12
  @silence RoundTrip.silence()
  @max 10_000

  @enforce_keys [:target, :deadline, :trip]
  defstruct [
    :target,
    :deadline,
    :trip,
    :due,
    :since,
    :count,
    :last,
    :only,
    entries: %{},
    repeats: 0,
    phase: :idle
  ]

  @type t :: %__MODULE__{}

  @typedoc "`time`: unix seconds of its beginning, nil if the vehicle did not know the time; `size` in bytes"
  @type entry :: %{id: 0..65_535, size: non_neg_integer(), time: pos_integer() | nil}
  @type reason :: :no_answer | {:missing, pos_integer()} | {:too_many, pos_integer()} | :deadline | :cancelled

  @doc "A list that is not requested yet. Options: `:rtt_us`, `:only` (the id of the one entry that is wanted)."
  @spec new({non_neg_integer(), 0..255}, deadline :: integer(), keyword()) :: t()
  def new(target, deadline, options \\ []),
    do: %__MODULE__{
      target: target,
      deadline: deadline,
      trip: RoundTrip.new(options[:rtt_us]),
      only: options[:only]
    }

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: :asked} = list), do: min(list.due, list.deadline)
  def wake_at(_list), do: nil

  @spec handle(t(), Aerie.Control.Logs.Download.event()) :: {t(), [Aerie.Control.Logs.Download.action()]}
  def handle(%{phase: :done} = list, _event), do: {list, []}
  def handle(list, {:cancel, _now}), do: finish(list, {:error, :cancelled})

  def handle(%{deadline: deadline} = list, {_event, now}) when now >= deadline,
    do: finish(list, {:error, :deadline})

  def handle(%{phase: :idle} = list, {:start, now}), do: ask_all(%{list | phase: :asked, since: now}, now)
  # After a restart the list may have changed.
  def handle(%{phase: :asked} = list, {:rebooted, now}),
    do: ask_all(%{list | entries: %{}, count: nil, last: nil}, now)

  def handle(%{phase: :asked, due: due} = list, {:tick, now}) when now >= due, do: late(list, now)

  def handle(%{phase: :asked, target: from} = list, {:message, %M.LogEntry{} = m, from, now}) do
    cond do
      m.num_logs == 0 -> finish(list, {:ok, []})
      list.only != nil -> one(list, m)
      m.num_logs > @max -> finish(list, {:error, {:too_many, m.num_logs}})
      true -> receive_entry(list, m, now)
    end
  end

  def handle(list, _other), do: {list, []}

  defp one(%{only: id} = list, %{id: id} = m), do: finish(list, {:ok, [entry(m)]})

  defp one(%{only: id} = list, m) do
    ids = announced(m.num_logs, m.last_log_num)
    if m.id in ids and id not in ids, do: finish(list, {:ok, []}), else: {list, []}
  end

  defp entry(m), do: %{id: m.id, size: m.size, time: if(m.time_utc > 0, do: m.time_utc)}

  defp receive_entry(list, m, now) do
    entry = entry(m)
    same? = list.count in [nil, m.num_logs]
    entries = if same?, do: list.entries, else: %{}
    new? = not is_map_key(entries, m.id)

    list = %{
      list
      | entries: Map.put(entries, m.id, entry),
        count: m.num_logs,
        last: if(same?, do: max(list.last || 0, m.last_log_num), else: m.last_log_num),
        since: if(new?, do: now, else: list.since),
        repeats: if(new?, do: 0, else: list.repeats)
    }

    if map_size(list.entries) >= list.count and complete?(list),
      do: finish(list, {:ok, logs(list)}),
      else: {%{list | due: now + RoundTrip.timeout(list.trip)}, []}
  end

  # The ids that a vehicle says it has; none if it cannot have as many up to the last one.
  defp announced(count, last) when is_integer(last) and last >= count - 1, do: (last - count + 1)..last//1
  defp announced(_count, _last), do: 0..-1//1

  # What it sends may show that it has others.
  defp announced(list) do
    ids = announced(list.count, list.last)
    other? = fn {id, entry} -> said?(entry) and id not in ids end
    if Enum.any?(list.entries, other?), do: 0..-1//1, else: ids
  end

  defp complete?(list) do
    ids = announced(list)
    said = Enum.count(list.entries, fn {_id, entry} -> said?(entry) end)
    said >= list.count or (not Enum.empty?(ids) and Enum.all?(ids, &is_map_key(list.entries, &1)))
  end

  defp said?(entry), do: entry.size > 0 or entry.time != nil

  defp logs(list) do
    ids = announced(list)
    sorted(for {id, entry} <- list.entries, said?(entry) or id in ids, do: entry)
  end

  defp sorted(entries), do: Enum.sort_by(entries, & &1.id)

  defp late(%{repeats: repeats, since: since} = list, now)
       when repeats >= @repeats and now - since >= @silence do
    why = if list.count, do: {:missing, list.count - map_size(list.entries)}, else: :no_answer
    finish(list, {:error, why})
  end

  # What was announced does not come, and there are as many.
  defp late(%{repeats: repeats, count: count} = list, _now)
       when repeats >= 2 and is_integer(count) and map_size(list.entries) >= count,
       do: finish(list, {:ok, sorted(Map.values(list.entries))})

  defp late(list, now) do
    list = %{list | repeats: list.repeats + 1}

    case missing(list) do
      [] -> ask_all(list, now)
      missing -> ask(list, hd(missing), List.last(missing), now)
    end
  end

  defp missing(list),
    do: for(id <- announced(list), not is_map_key(list.entries, id), do: id)

  defp ask_all(%{only: nil} = list, now), do: ask(list, 0, 0xFFFF, now)
  # A vehicle says nothing of an id that it does not have; any entry says which ones it has.
  defp ask_all(%{repeats: repeats} = list, now) when rem(repeats, 2) == 1, do: ask(list, 0, 0xFFFF, now)
  defp ask_all(%{only: id} = list, now), do: ask(list, id, id, now)

  defp ask(%{target: {system, component}} = list, first, last, now) do
    message = %M.LogRequestList{target_system: system, target_component: component, start: first, end: last}
    {%{list | due: now + RoundTrip.timeout(list.trip, div(list.repeats, 4))}, [{:send, [message]}]}
  end

  defp finish(list, result), do: {%{list | phase: :done}, [{:done, result}]}
end
