defmodule Aerie.Fleet.Wants do
  @moduledoc """
  Which client wants which message of which vehicle how often: a table of the store, so that a session that died finds it
  again. Written by whoever serves the client, read by the vehicle's session.

  A client is any term that tells it from others. One that is a pid, or a tuple with a pid in front, goes with its process
  (`sweep/2`). At most #{2_048} wants of a vehicle are kept.
  """

  alias Aerie.Store
  alias Aerie.Names

  @max_wants 2_048
  # No link carries more, and an interval has to be at least a microsecond.
  @max_hz 1_000

  @typedoc "A message id, or a group of REQUEST_DATA_STREAM."
  @type what :: non_neg_integer() | {:group, non_neg_integer()}
  @type client :: term()
  @type merged :: %{
          messages: %{non_neg_integer() => number()},
          groups: %{non_neg_integer() => number()}
        }

  @doc "Notes a want, in messages per second; nil takes it back. `:same` when nothing changed by it."
  @spec put(Names.gateway(), Store.vehicle_key(), client(), what(), number() | nil) ::
          :ok | :same | {:error, :too_many}
  def put(gateway, key, client, what, nil) do
    if :ets.take(table(gateway), {key, client, what}) == [], do: :same, else: :ok
  end

  def put(gateway, key, client, what, hz) when is_number(hz) and hz > 0 do
    table = table(gateway)
    hz = min(hz, @max_hz)
    row = {key, client, what}

    case :ets.lookup(table, row) do
      [{^row, ^hz}] ->
        :same

      [] ->
        if count(table, key) < @max_wants, do: insert(table, row, hz), else: refuse(gateway)

      [_other_rate] ->
        insert(table, row, hz)
    end
  end

  defp insert(table, row, hz) do
    true = :ets.insert(table, {row, hz})
    :ok
  end

  defp refuse(gateway) do
    Store.count(gateway, {:wants, :refused})
    {:error, :too_many}
  end

  defp count(table, key), do: :ets.select_count(table, [{{{key, :_, :_}, :_}, [], [true]}])

  @doc "The wants of a vehicle, of each thing the highest. `but` leaves one client out."
  @spec merged(Names.gateway(), Store.vehicle_key(), but :: {:but, client()} | :all) :: merged()
  def merged(gateway, key, but \\ :all) do
    Store.with_table(gateway, :wants, %{messages: %{}, groups: %{}}, fn table ->
      table
      |> :ets.select([{{{key, :"$1", :"$2"}, :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}])
      |> Enum.reduce(%{messages: %{}, groups: %{}}, fn
        {client, _what, _hz}, merged when but == {:but, client} -> merged
        {_client, {:group, group}, hz}, merged -> %{merged | groups: highest(merged.groups, group, hz)}
        {_client, id, hz}, merged -> %{merged | messages: highest(merged.messages, id, hz)}
      end)
    end)
  end

  defp highest(map, what, hz), do: Map.update(map, what, hz, &max(&1, hz))

  @doc "All wants of a vehicle as they are: `[{client, what, hz}]`."
  @spec list(Names.gateway(), Store.vehicle_key()) :: [{client(), what(), number()}]
  def list(gateway, key) do
    Store.with_table(gateway, :wants, [], fn table ->
      :ets.select(table, [{{{key, :"$1", :"$2"}, :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}])
    end)
  end

  @doc "Takes back all wants of a client; the vehicles that it concerns."
  @spec forget(Names.gateway(), client()) :: [Store.vehicle_key()]
  def forget(gateway, client) do
    Store.with_table(gateway, :wants, [], &forget_in(&1, client))
  end

  defp forget_in(table, client) do
    keys = :ets.select(table, [{{{:"$1", :"$2", :_}, :_}, [{:"=:=", :"$2", {:const, client}}], [:"$1"]}])
    :ets.select_delete(table, [{{{:_, :"$1", :_}, :_}, [{:"=:=", :"$1", {:const, client}}], [true]}])
    Enum.uniq(keys)
  end

  @doc "Takes back the wants of a vehicle's clients whose process is no more; whether there were any."
  @spec sweep(Names.gateway(), Store.vehicle_key()) :: boolean()
  def sweep(gateway, key) do
    gone = for {client, _what, _hz} <- list(gateway, key), gone?(client), uniq: true, do: client
    Enum.each(gone, &forget(gateway, &1))
    gone != []
  end

  defp gone?(pid) when is_pid(pid), do: node(pid) == node() and not Process.alive?(pid)

  defp gone?(client) when is_tuple(client) and tuple_size(client) > 0,
    do: is_pid(elem(client, 0)) and gone?(elem(client, 0))

  defp gone?(_name), do: false

  @doc "The table that the store keeps for them."
  @spec table() :: Store.table()
  def table, do: {:wants, [:ordered_set, read_concurrency: true], []}

  defp table(gateway), do: Store.table!(gateway, :wants)
end
