defmodule Aerie.Vehicle.Services.StreamDemand do
  @max_demands 2_048

  @moduledoc """
  Which client wants which message of which vehicle at which rate: a table in the store, so that it survives a crash of the
  session. Written by whatever serves the client, read by the vehicle's session.

  A client is any unique term. If it is a pid, or a tuple with a pid in front, its demands end with that process (`sweep/2`). At
  most #{@max_demands} demands per vehicle are kept.
  """

  alias Aerie.Base.Store
  alias Aerie.Base.Names

  # No link carries more, and an interval has to be at least a microsecond.
  @max_hz 1_000

  @typedoc "A message id, or a group of REQUEST_DATA_STREAM."
  @type what :: non_neg_integer() | {:group, non_neg_integer()}
  @type client :: term()
  @type merged :: %{
          messages: %{non_neg_integer() => number()},
          groups: %{non_neg_integer() => number()}
        }

  @doc "Sets a client's demand in messages per second; nil withdraws it. `:same` if that changes nothing."
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
        if count(table, key) < @max_demands, do: insert(table, row, hz), else: refuse(gateway)

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

  @doc "The highest rate that is wanted of each message and group of a vehicle. `but` leaves one client out."
  @spec merged(Names.gateway(), Store.vehicle_key(), but :: {:but, client()} | :all) :: merged()
  def merged(gateway, key, but \\ :all) do
    Enum.reduce(list(gateway, key), %{messages: %{}, groups: %{}}, fn
      {client, _what, _hz}, merged when but == {:but, client} -> merged
      {_client, {:group, group}, hz}, merged -> %{merged | groups: highest(merged.groups, group, hz)}
      {_client, id, hz}, merged -> %{merged | messages: highest(merged.messages, id, hz)}
    end)
  end

  defp highest(map, what, hz), do: Map.update(map, what, hz, &max(&1, hz))

  @doc "All demands on a vehicle: `[{client, what, hz}]`."
  @spec list(Names.gateway(), Store.vehicle_key()) :: [{client(), what(), number()}]
  def list(gateway, key) do
    Store.with_table(gateway, :stream_demand, [], fn table ->
      :ets.select(table, [{{{key, :"$1", :"$2"}, :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}])
    end)
  end

  @doc "Withdraws all demands of a client, and returns the vehicles that they were for."
  @spec forget(Names.gateway(), client()) :: [Store.vehicle_key()]
  def forget(gateway, client) do
    spec = &[{{{:"$1", :"$2", :_}, :_}, [{:"=:=", :"$2", {:const, client}}], [&1]}]
    keys = Store.with_table(gateway, :stream_demand, [], &:ets.select(&1, spec.(:"$1")))
    _deleted = Store.with_table(gateway, :stream_demand, 0, &:ets.select_delete(&1, spec.(true)))
    Enum.uniq(keys)
  end

  @doc "Withdraws the demands of clients whose process has ended, and returns whether there were any."
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

  @doc "The table that the store owns for this module."
  @spec table() :: Store.table()
  def table, do: {:stream_demand, [:ordered_set, read_concurrency: true], []}

  defp table(gateway), do: Store.table!(gateway, :stream_demand)
end
