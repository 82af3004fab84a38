defmodule Aerie.Fleet.Remote.Table do
  @moduledoc """
  Vehicles that other gateways hear, as they tell it over NATS: a table in the store, which `Aerie.Fleet.Remote.Listener` alone writes.

      {{id, :gateway, name}, %{heard: us, facts: snapshot}}            a gateway that hears it, and what it says of it
      {{id, :group, group}, %{data, at, time_boot_ms, via}}            the newest value of a group, and whose it is
      {:settings, %{stale_us, lost_us}}

  `heard` is when this gateway got the last word, `at` when the value was true, by this gateway's clock.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Snapshot

  @doc "The table that the store owns for this module."
  @spec table() :: Store.table()
  def table, do: {:remote_vehicles, [:ordered_set, read_concurrency: true], []}

  @doc "After how many microseconds without a word of its gateways a vehicle is stale, and lost."
  @spec configure(Names.gateway(), %{stale_us: pos_integer(), lost_us: pos_integer()}) :: :ok
  def configure(gateway, settings), do: insert(gateway, {:settings, settings})

  @doc "A gateway has given a sign of a vehicle."
  @spec put_gateway(Names.gateway(), String.t(), name :: String.t(), Snapshot.t() | nil, heard :: integer()) ::
          :ok
  def put_gateway(gateway, id, name, facts, heard),
    do: insert(gateway, {{id, :gateway, name}, %{heard: heard, facts: facts}})

  @doc "A value of a vehicle, unless a newer one is known."
  @spec put(Names.gateway(), String.t(), atom(), map()) :: :ok
  def put(gateway, id, group, value) do
    key = {id, :group, group}

    case Store.with_table(gateway, :remote_vehicles, nil, &:ets.lookup_element(&1, key, 2, nil)) do
      %{at: at} when at > value.at -> :ok
      _older_or_none -> insert(gateway, {key, value})
    end
  end

  @doc "Forgets a vehicle."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, id) do
    for kind <- [:gateway, :group],
        do: :ets.match_delete(Store.table!(gateway, :remote_vehicles), {{id, kind, :_}, :_})

    :ok
  end

  @doc "Which gateways announced which vehicles: `[{id, name, what}]`."
  @spec gateways(Names.gateway()) :: [
          {String.t(), String.t(), %{heard: integer(), facts: Snapshot.t() | nil}}
        ]
  def gateways(gateway) do
    Store.with_table(gateway, :remote_vehicles, [], fn table ->
      :ets.select(table, [{{{:"$1", :gateway, :"$2"}, :"$3"}, [], [{{:"$1", :"$2", :"$3"}}]}])
    end)
  end

  @doc "All remote vehicles as snapshots, by their ids."
  @spec vehicles(Names.gateway(), now :: integer()) :: %{String.t() => Snapshot.t()}
  def vehicles(gateway, now) do
    {rows, limits} = gateway |> Store.with_table(:remote_vehicles, [], &:ets.tab2list/1) |> split()

    rows
    |> Enum.group_by(fn {{id, _kind, _name}, _value} -> id end)
    |> Map.new(fn {id, rows} -> {id, snapshot(id, rows, limits, now)} end)
  end

  defp split(rows) do
    case Enum.split_with(rows, &match?({:settings, _limits}, &1)) do
      {[{:settings, limits}], rows} -> {rows, limits}
      {[], _nobody_listens} -> {[], nil}
    end
  end

  @doc "A remote vehicle as a snapshot; nil if no gateway announced it."
  @spec vehicle(Names.gateway(), String.t(), now :: integer()) :: Snapshot.t() | nil
  def vehicle(gateway, id, now) do
    rows =
      Store.with_table(gateway, :remote_vehicles, [], fn table ->
        :ets.select(table, [{{{id, :_, :_}, :_}, [], [:"$_"]}])
      end)

    limits = Store.with_table(gateway, :remote_vehicles, nil, &:ets.lookup_element(&1, :settings, 2, nil))
    if rows != [] and limits != nil, do: snapshot(id, rows, limits, now)
  end

  @nothing %Snapshot{autopilot: :generic, status: :online}

  # `key` is nobody's on this gateway's own networks, whose names have no slash.
  defp snapshot(id, rows, limits, now) do
    gateways = for {{_id, :gateway, name}, what} <- rows, do: {name, what}
    groups = for {{_id, :group, group}, value} <- rows, into: %{}, do: {group, value}
    {via, best} = Enum.max_by(gateways, &rank(&1, limits, now), fn -> {nil, %{heard: 0, facts: nil}} end)
    facts = best.facts || @nothing

    %{
      facts
      | id: id,
        key: {"nats/#{via}/#{facts.network}", facts.system_id || 0},
        status: status(facts.status, now - best.heard, limits),
        last_heard: facts.last_heard || newest(groups),
        groups: groups,
        via: via,
        gateways: Enum.sort(for {name, _what} <- gateways, do: name)
    }
  end

  # Among several gateways, the one that hears it and spoke last.
  defp rank({_name, %{heard: heard, facts: facts}}, limits, now) do
    order = %{online: 2, stale: 1, lost: 0}
    {order[status((facts || @nothing).status, now - heard, limits)], heard}
  end

  defp status(:lost, _silent, _limits), do: :lost
  defp status(_told, silent, %{lost_us: lost}) when silent > lost, do: :lost
  defp status(_told, silent, %{stale_us: stale}) when silent > stale, do: :stale
  defp status(told, _silent, _limits), do: told

  defp newest(groups), do: groups |> Enum.map(fn {_group, %{at: at}} -> at end) |> Enum.max(fn -> nil end)

  defp insert(gateway, row) do
    true = :ets.insert(Store.table!(gateway, :remote_vehicles), row)
    :ok
  end
end
