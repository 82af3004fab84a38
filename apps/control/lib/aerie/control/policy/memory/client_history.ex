defmodule Aerie.Control.Policy.Memory.ClientHistory do
  @moduledoc """
  What clients did lately, as the policy for raw MAVLink needs it: how often they commanded, the last item of an upload, which refusals
  they were sent. A table of the store, which the clients' processes read and change without waiting for another, so a client with
  two connections has one history.

  A row is `{{owner, kind, detail}, value, until}`; it counts until then (monotonic µs). An owner is a principal, never
  a connection: there are as many as the configuration names; or a vehicle, for the plans that are written to it.
  Each has room for 500 rows of each kind whatever the others do, and for 4,000 while there are fewer than 20,000 in
  all; there are never more than 40,000.
  """

  alias Aerie.Base.{Names, Store}

  @max 20_000
  @max_each 4_000
  @reserved 500
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

  @doc "Takes the rows of a kind whose values `fun` wants; none while the store does not run."
  @spec take(Names.gateway(), kind :: atom(), (value() -> boolean())) :: [value()]
  def take(gateway, kind, fun) do
    case Names.held(gateway, :store) do
      %{client_history: table} ->
        for {_key, value, _until} = row <- :ets.match_object(table, {{:_, kind, :_}, :_, :_}),
            fun.(value),
            # Another process may have changed it meanwhile.
            :ets.select_delete(table, [{:"$1", [{:"=:=", :"$1", {:const, row}}], [true]}]) == 1,
            do: value

      nil ->
        []
    end
  end

  defp current({_key, value, until}, now) when until > now, do: value
  defp current(_none_or_over, _now), do: nil

  defp swap(table, nil, new), do: :ets.insert_new(table, new)

  defp swap(table, {key, _value, _until} = old, new),
    do: :ets.select_replace(table, [{{key, :_, :_}, [{:"=:=", :"$_", {:const, old}}], [{:const, new}]}]) == 1

  defp room?(table, {owner, kind, _detail}, now),
    do: few?(table, owner, kind) or (sweep?(table, now) and few?(table, owner, kind))

  # While there are fewer than are reserved for one owner, nobody counts them.
  defp few?(table, owner, kind) do
    size = :ets.info(table, :size)

    size < @reserved or
      (size <= 2 * @max and rows(table, owner, kind) < if(size <= @max, do: @max_each, else: @reserved))
  end

  defp rows(table, owner, kind),
    do: :ets.select_count(table, [{{{owner, kind, :_}, :_, :_}, [], [true]}])

  defp sweep?(table, now) do
    turn = [{{:swept, :"$1"}, [{:<, :"$1", now - @sweep_us}], [{{:swept, now}}]}]

    :ets.select_replace(table, turn) == 1 and
      :ets.select_delete(table, [{{:_, :_, :"$1"}, [{:"=<", :"$1", now}], [true]}]) > 0
  end
end
