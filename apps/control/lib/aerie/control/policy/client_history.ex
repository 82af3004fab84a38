defmodule Aerie.Control.Policy.ClientHistory do
  @moduledoc """
  What clients did lately, as the policy for raw MAVLink needs it: how often they commanded, the last item of an upload, which refusals
  they were sent. A table of the store, which the clients' processes read and change without waiting for another, so a client with
  two connections has one history.

  A row is `{{owner, kind, detail}, value, until}`; it counts until then (monotonic µs). There are at most 20,000 rows, and 4,000 of
  each owner, so that no client takes the room of the others.
  """

  alias Aerie.Base.{Names, Store}

  @max 20_000
  @max_each 4_000
  # How often rows that count no longer are looked for while there is no room.
  @sweep_us 1_000_000

  @type key :: {owner :: term(), kind :: atom(), detail :: term()}
  @type value :: term()

  @doc "The table that the store owns for this module."
  @spec table() :: Store.table()
  def table do
    # A size that is asked for with each new row must not wait for all schedulers.
    shared = [read_concurrency: true, write_concurrency: true, decentralized_counters: false]
    {:client_history, [:ordered_set | shared], [{:swept, System.monotonic_time(:microsecond)}]}
  end

  @doc """
  Changes what is known of a key at `now` (monotonic µs). `fun` gets the value, nil for none, and gives `{:put, result, value, until}`
  or `{:keep, result}`; it is called again when another process was faster. `:full`: there is no room for another key.
  """
  @spec update(Names.gateway(), key(), integer(), (value() | nil -> change)) :: result | :full
        when change: {:put, result, value(), until :: integer()} | {:keep, result}, result: term()
  def update(gateway, key, now, fun) do
    table = Store.table!(gateway, :client_history)
    row = List.first(:ets.lookup(table, key))

    with {:put, result, value, until} <- fun.(current(row, now)),
         new = {key, value, until},
         {:room, true} <- {:room, row != nil or room?(table, key, now)} do
      if swap(table, row, new), do: result, else: update(gateway, key, now, fun)
    else
      {:keep, result} -> result
      {:room, false} -> :full
    end
  end

  defp current({_key, value, until}, now) when until > now, do: value
  defp current(_none_or_over, _now), do: nil

  defp swap(table, nil, new), do: :ets.insert_new(table, new)

  defp swap(table, {key, _value, _until} = old, new),
    do: :ets.select_replace(table, [{{key, :_, :_}, [{:"=:=", :"$_", {:const, old}}], [{:const, new}]}]) == 1

  defp room?(table, {owner, _kind, _detail}, now),
    do: few?(table, owner) or (sweep?(table, now) and few?(table, owner))

  # While there are less than one owner may have, nobody counts them.
  defp few?(table, owner) do
    size = :ets.info(table, :size)

    size < @max_each or
      (size <= @max and :ets.select_count(table, [{{{owner, :_, :_}, :_, :_}, [], [true]}]) < @max_each)
  end

  defp sweep?(table, now) do
    turn = [{{:swept, :"$1"}, [{:<, :"$1", now - @sweep_us}], [{{:swept, now}}]}]

    :ets.select_replace(table, turn) == 1 and
      :ets.select_delete(table, [{{:_, :_, :"$1"}, [{:"=<", :"$1", now}], [true]}]) > 0
  end
end
