defmodule Aerie.Fleet.Inspector.Rows do
  @moduledoc """
  The table of `Aerie.Fleet.Inspector`: one row for each message of a component by a link, with its count, its rate and its last frame. The
  inspector writes, everybody reads.
  """

  alias Aerie.Fleet.Inspector
  alias Aerie.Fleet.Inspector.Fields
  alias MavCodec.Frame

  @max_rows 8_192
  @forget_ms 60_000
  # How much of the former rate stays in the mean.
  @keep 0.5

  @type t :: :ets.table()

  # {key, count, at, bytes, crc_extra, counted before, rate, monotonic ms of the last change}
  @count 2
  @at 3
  @before 6
  @rate 7

  @doc "An empty table, owned by the calling process."
  @spec new() :: t
  def new do
    table = :ets.new(:inspector, [:ordered_set, :protected, read_concurrency: true])
    clear(table)
    table
  end

  @doc "Forgets everything."
  @spec clear(t) :: :ok
  def clear(table) do
    :ets.delete_all_objects(table)
    :ets.insert(table, [{:skipped, 0}, {:odd, 0}, {:measured, System.monotonic_time(:millisecond)}])
    :ok
  end

  @doc "Counts frames of a link, and keeps the last one of each kind; beyond #{@max_rows} rows new ones are left out and counted."
  @spec add(t, String.t(), :in | :out, [Frame.t()]) :: :ok
  def add(table, link, direction, frames), do: Enum.each(frames, &add_frame(table, link, direction, &1))

  defp add_frame(table, link, direction, %Frame{} = frame) do
    key = {link, direction, frame.system, frame.component, frame.id}
    # Copied, because it is a part of a whole read.
    changes = [{@at, frame.at}, {4, :binary.copy(frame.bytes)}, {5, frame.crc_extra}]

    cond do
      :ets.update_element(table, key, changes) ->
        :ets.update_counter(table, key, {@count, 1})

      :ets.info(table, :size) < @max_rows ->
        :ets.insert(table, {key, 1, frame.at, :binary.copy(frame.bytes), frame.crc_extra, 0, nil, now()})

      true ->
        :ets.update_counter(table, :odd, 1)
    end
  end

  @doc "Measures the rates since the last call, and forgets rows that have been silent for a minute. `dropped`: by the taps, in all."
  @spec measure(t, non_neg_integer, integer) :: :ok
  def measure(table, dropped, now) do
    seconds = max(now - :ets.lookup_element(table, :measured, 2), 1) / 1000
    :ets.insert(table, [{:measured, now}, {:skipped, dropped}])

    for {key, count, before, rate, changed} <-
          :ets.select(table, [
            {{:"$1", :"$2", :_, :_, :_, :"$3", :"$4", :"$5"}, [], [{{:"$1", :"$2", :"$3", :"$4", :"$5"}}]}
          ]) do
      cond do
        count > before ->
          :ets.update_element(table, key, [
            {@before, count},
            {@rate, mean(rate, (count - before) / seconds)},
            {8, now}
          ])

        now - changed > @forget_ms ->
          :ets.delete(table, key)

        true ->
          :ets.update_element(table, key, {@rate, mean(rate, 0.0)})
      end
    end

    :ok
  end

  defp mean(nil, rate), do: rate
  defp mean(before, rate), do: before * @keep + rate * (1 - @keep)

  @doc "See `Aerie.Fleet.Inspector.rows/2`."
  @spec list(t, keyword) :: [Inspector.row()]
  def list(table, filter) do
    key = {
      Keyword.get(filter, :link, :_),
      Keyword.get(filter, :direction, :_),
      Keyword.get(filter, :system, :_),
      Keyword.get(filter, :component, :_),
      Keyword.get(filter, :id, :_)
    }

    pattern = {key, :"$1", :"$2", :_, :_, :_, :"$3", :_}
    # The key itself cannot be both a pattern and a variable.
    for [key, count, at, rate] <-
          :ets.select(table, [{pattern, [], [[{:element, 1, :"$_"}, :"$1", :"$2", :"$3"]]}]),
        do: %{key: key, name: Fields.name(elem(key, 4)), count: count, hz: rate || 0.0, at: at}
  end

  @doc "See `Aerie.Fleet.Inspector.last/2`."
  @spec frame(t, Inspector.key()) :: Frame.t() | nil
  def frame(table, key) do
    case :ets.lookup(table, key) do
      [{_key, _count, at, bytes, extra, _before, _rate, _changed}] -> Frame.from_bytes(bytes, extra, at)
      [] -> nil
    end
  end

  @doc "See `Aerie.Fleet.Inspector.skipped/1`."
  @spec skipped(t) :: non_neg_integer
  def skipped(table), do: counted(table, :skipped) + counted(table, :odd)

  defp counted(table, key) do
    # Absent for a moment while everything is forgotten.
    count = :ets.lookup_element(table, key, 2, 0)
    true = is_integer(count)
    count
  end

  defp now, do: System.monotonic_time(:millisecond)
end
