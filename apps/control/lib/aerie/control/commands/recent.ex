defmodule Aerie.Control.Commands.Recent do
  @max 1_024

  @moduledoc """
  The commands under way and the last #{@max} that ended, of all vehicles and all operators: a table of the store that everybody
  may read. `Aerie.Control.Commands.Server` writes it; subscribers of `{:commands, vehicle}` (`Aerie.Base.PubSub`) get the id of the command that changed.

      {{:under_way, id}, entry}     {{:done, n}, entry}
  """

  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.PubSub

  @typedoc """
    * `:source` - who commanded, `:via` - by which way
    * `:at` - when it came, `:done_at` - when it had its result, nil before (unix microseconds)
    * `:progress` - the vehicle's last word: `%{"progress" => share | nil, "text" => text | nil}`
    * `:result` - nil while it is under way
  """
  @type entry :: %{
          id: String.t(),
          vehicle: String.t(),
          type: String.t(),
          params: %{atom() => term()},
          source: String.t(),
          via: String.t(),
          at: integer(),
          progress: map() | nil,
          result: Result.t() | nil,
          done_at: integer() | nil
        }

  @doc "The table that the store owns for this module."
  @spec table() :: Store.table()
  def table, do: {:commands, [:ordered_set, read_concurrency: true, write_concurrency: true], [{:last, 0}]}

  @doc "The commands of a vehicle, the latest first: those under way, then at most `limit` that had their end."
  @spec of(Names.gateway(), vehicle :: String.t(), limit :: non_neg_integer()) :: [entry()]
  def of(gateway, vehicle, limit) do
    {under_way, done} =
      gateway
      |> Store.with_table(:commands, [], &:ets.select(&1, [{{:_, %{vehicle: vehicle}}, [], [:"$_"]}]))
      |> Enum.split_with(&match?({{:under_way, _id}, _entry}, &1))

    under_way = Enum.sort_by(under_way, fn {_key, entry} -> -entry.at end)
    done = Enum.reverse(done)

    # A command that is asked for again is under way once more, until it has given its stored result.
    (under_way ++ done)
    |> Enum.map(fn {_key, entry} -> entry end)
    |> Enum.uniq_by(& &1.id)
    |> Enum.take(length(under_way) + limit)
  end

  @doc "A command has come and is under way."
  @spec begun(Names.gateway(), Aerie.Vehicle.Command.t(), via :: String.t()) :: :ok
  def begun(gateway, command, via) do
    entry = Map.take(command, [:id, :vehicle, :type, :params, :source])
    entry = Map.merge(entry, %{via: via, at: now(), progress: nil, result: nil, done_at: nil})
    put(gateway, {:under_way, command.id}, entry)
  end

  @doc "The vehicle said how far it is."
  @spec progress(Names.gateway(), id :: String.t(), map()) :: :ok
  def progress(gateway, id, progress) do
    case :ets.lookup(Store.table!(gateway, :commands), {:under_way, id}) do
      [{key, entry}] -> put(gateway, key, %{entry | progress: progress})
      [] -> :ok
    end
  end

  @doc "A command has its result."
  @spec done(Names.gateway(), Result.t()) :: :ok
  def done(gateway, result) do
    table = Store.table!(gateway, :commands)

    case :ets.take(table, {:under_way, result.id}) do
      [{_key, entry}] ->
        n = :ets.update_counter(table, :last, 1)
        :ets.delete(table, {:done, n - @max})
        put(gateway, {:done, n}, %{entry | result: result, done_at: now()})

      [] ->
        :ok
    end
  end

  @doc "The server was restarted: what it had under way has an unknown end."
  @spec abandoned(Names.gateway()) :: :ok
  def abandoned(gateway) do
    ids =
      Store.with_table(gateway, :commands, [], &:ets.select(&1, [{{{:under_way, :"$1"}, :_}, [], [:"$1"]}]))

    Enum.each(ids, &done(gateway, Refusal.result(&1, Refusal.ended(:commands_restarted))))
  end

  defp put(gateway, key, entry) do
    true = :ets.insert(Store.table!(gateway, :commands), {key, entry})
    PubSub.publish(gateway, {:commands, entry.vehicle}, entry.id)
  end

  defp now, do: System.os_time(:microsecond)
end
