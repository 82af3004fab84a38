defmodule Aerie.Control.Logs.List do
  @moduledoc """
  Lists the logs of a vehicle (LOG_REQUEST_LIST). Pure: `handle(list, event) -> {list, actions}`, with the events and actions of
  `Aerie.Control.Logs.Download`; the end is `{:done, {:ok, [entry]} | {:error, reason}}`.

  Ids begin at 0 (PX4) or 1 (ArduPilot); a vehicle without logs answers with id 0 and num_logs 0 (X1).
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
    do: ask_all(%{list | entries: %{}, count: nil}, now)

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

  defp one(%{only: id} = list, m) when id > m.last_log_num or id <= m.last_log_num - m.num_logs,
    do: finish(list, {:ok, []})

  defp one(list, _another), do: {list, []}

  defp entry(m), do: %{id: m.id, size: m.size, time: if(m.time_utc > 0, do: m.time_utc)}

  defp receive_entry(list, m, now) do
    entry = entry(m)
    entries = if list.count in [nil, m.num_logs], do: list.entries, else: %{}

    list = %{
      list
      | entries: Map.put(entries, m.id, entry),
        count: m.num_logs,
        last: m.last_log_num,
        since: now,
        repeats: 0
    }

    if map_size(list.entries) >= list.count,
      do: finish(list, {:ok, Enum.sort_by(Map.values(list.entries), & &1.id)}),
      else: {%{list | due: now + RoundTrip.timeout(list.trip)}, []}
  end

  defp late(%{repeats: repeats, since: since} = list, now)
       when repeats >= @repeats and now - since >= @silence do
    why = if list.count, do: {:missing, list.count - map_size(list.entries)}, else: :no_answer
    finish(list, {:error, why})
  end

  defp late(list, now) do
    list = %{list | repeats: list.repeats + 1}

    case missing(list) do
      [] -> ask_all(list, now)
      missing -> ask(list, hd(missing), List.last(missing), now)
    end
  end

  defp missing(%{count: nil}), do: []

  defp missing(list),
    do: for(id <- max(list.last - list.count + 1, 0)..list.last//1, not is_map_key(list.entries, id), do: id)

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
