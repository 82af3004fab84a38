defmodule Aerie.Base.Store do
  @moduledoc """
  The read model: one snapshot per vehicle and per link, counters, and the systems that were heard.

  This process does nothing but own ETS tables, so these outlive every vehicle, link and bridge process, and a process that is
  restarted finds what the former one knew. Sessions and links write their own snapshots directly; console, REST, metrics and bridge
  read the tables directly. Nobody waits for a process.

  While the gateway is not running, reading gives nothing (`[]`, `nil`) and writing raises: a reader must be prepared for an absent
  gateway anyway, but a writer must not run without a store.

  What is in a snapshot is its writer's affair, but for a vehicle's `:id`. A link's peers are rows of their own
  (`Aerie.Base.Store.Links`).
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Base.Store.Links
  alias Aerie.Base.PubSub

  @type vehicle_key :: {network :: String.t(), system_id :: non_neg_integer()}
  @type snapshot :: map()
  @type counter :: term()

  # Everything that sends a heartbeat is a system: a noisy or hostile network could name four billion of them.
  @max_systems 4096
  @max_claims 4096

  @typedoc "A table of another part: its name, ETS options besides `:public`, and its first objects."
  @type table :: {atom(), [atom() | tuple()], [tuple()]}

  @doc """
  Options: `:gateway`; `:tables`, those of other parts, which are to outlive them; `:counters`, which are there from the start on, with 0.
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :store))
  end

  @doc """
  Writes a vehicle's snapshot and tells subscribers of `:vehicles` and `{:vehicle, id}` at the next tick, those of `:roster` at once
  that it is new.
  """
  @spec put_vehicle(Names.gateway(), vehicle_key(), snapshot()) :: :ok
  def put_vehicle(gateway, {_network, _system} = key, %{id: id} = snapshot) do
    :ets.insert(table!(gateway, :vehicles), {key, id, snapshot})
    if :ets.insert_new(table!(gateway, :vehicle_keys), {id, key}), do: PubSub.publish(gateway, :roster, id)
    PubSub.changed(gateway, {:vehicle, id})
  end

  @doc "Forgets a vehicle, and tells subscribers."
  @spec delete_vehicle(Names.gateway(), vehicle_key()) :: :ok
  def delete_vehicle(gateway, key) do
    case :ets.take(table!(gateway, :vehicles), key) do
      [{^key, id, _snapshot}] ->
        :ets.delete_object(table!(gateway, :vehicle_keys), {id, key})
        PubSub.publish(gateway, :roster, id)
        PubSub.changed(gateway, {:vehicle, id})

      [] ->
        :ok
    end
  end

  @doc "All vehicles' snapshots, in the order of their keys."
  @spec vehicles(Names.gateway()) :: [snapshot()]
  def vehicles(gateway) do
    rows = with_table(gateway, :vehicles, [], &:ets.tab2list/1)
    for {_key, _id, snapshot} <- Enum.sort(rows), do: snapshot
  end

  @doc "How many vehicles there are, lost ones among them."
  @spec vehicle_count(Names.gateway()) :: non_neg_integer()
  def vehicle_count(gateway), do: with_table(gateway, :vehicles, 0, &:ets.info(&1, :size))

  @doc "One vehicle's snapshot by its public id or by its key; nil when it was never heard."
  @spec vehicle(Names.gateway(), String.t() | vehicle_key()) :: snapshot() | nil
  def vehicle(gateway, {_network, _system} = key) do
    with_table(gateway, :vehicles, nil, &:ets.lookup_element(&1, key, 3, nil))
  end

  def vehicle(gateway, id) when is_binary(id) do
    key = with_table(gateway, :vehicle_keys, nil, &:ets.lookup_element(&1, id, 2, nil))
    key && vehicle(gateway, key)
  end

  @doc """
  Writes a link's snapshot, and what changed of its peers and sources, and tells subscribers of `:links` and `{:link, id}` at
  the next tick.
  """
  @spec put_link(Names.gateway(), link_id :: term(), snapshot(), Links.changes()) :: :ok
  def put_link(gateway, id, snapshot, changes \\ %{put: [], delete: :all}) do
    :ets.insert(table!(gateway, :links), {id, snapshot})
    :ok = Links.change(gateway, id, changes)
    PubSub.changed(gateway, {:link, id})
  end

  @doc "Forgets a link."
  @spec delete_link(Names.gateway(), term()) :: :ok
  def delete_link(gateway, id) do
    :ets.delete(table!(gateway, :links), id)
    :ok = Links.change(gateway, id, %{put: [], delete: :all})
    PubSub.changed(gateway, {:link, id})
  end

  @doc "All links' snapshots without their peers and sources (`Aerie.Base.Store.Links`), in the order of their ids."
  @spec links(Names.gateway()) :: [snapshot()]
  def links(gateway) do
    for {_id, snapshot} <- Enum.sort(with_table(gateway, :links, [], &:ets.tab2list/1)), do: snapshot
  end

  @doc "One link's snapshot without its peers and sources; nil when there is none."
  @spec link(Names.gateway(), term()) :: snapshot() | nil
  def link(gateway, id) do
    with_table(gateway, :links, nil, &:ets.lookup_element(&1, id, 2, nil))
  end

  @doc """
  Adds to a counter and gives its new value. A counter is any term and starts at 0; terms from outside must be checked first, because
  every counter is kept.
  """
  @spec count(Names.gateway(), counter(), integer()) :: integer()
  def count(gateway, counter, n \\ 1) do
    [value] = :ets.update_counter(table!(gateway, :counters), counter, [{2, n}], {counter, 0})
    value
  end

  @doc "Adds to a counter if the gateway is running: for callers whose work goes on without it."
  @spec count_if_running(Names.gateway(), counter(), integer()) :: :ok
  def count_if_running(gateway, counter, n \\ 1) do
    _value = with_table(gateway, :counters, nil, &:ets.update_counter(&1, counter, {2, n}, {counter, 0}))
    :ok
  end

  @doc "A counter's value, 0 when nothing was counted."
  @spec counter(Names.gateway(), counter()) :: integer()
  def counter(gateway, counter) do
    with_table(gateway, :counters, 0, &:ets.lookup_element(&1, counter, 2, 0))
  end

  @doc "Removes a vehicle's counters, `{:vehicle, id, _}`."
  @spec forget_counters(Names.gateway(), vehicle_id :: String.t()) :: :ok
  def forget_counters(gateway, id) do
    true = :ets.match_delete(table!(gateway, :counters), {{:vehicle, id, :_}, :_})
    :ok
  end

  @doc "All counters."
  @spec counters(Names.gateway()) :: %{counter() => integer()}
  def counters(gateway) do
    Map.new(with_table(gateway, :counters, [], &:ets.tab2list/1))
  end

  @doc """
  True for one of the processes that claim the same within `interval_ms`: that one is to do it.
  """
  @spec claim(Names.gateway(), term(), pos_integer()) :: boolean()
  def claim(gateway, what, interval_ms) do
    table = table!(gateway, :claims)
    now = System.monotonic_time(:millisecond)
    # Most claims are of peers that are gone; to forget the others does no harm.
    if :ets.info(table, :size) > @max_claims, do: :ets.delete_all_objects(table)

    :ets.insert_new(table, {what, now}) or
      :ets.select_replace(table, [
        {{what, :"$1"}, [{:"=<", :"$1", now - interval_ms}], [{{{:const, what}, now}}]}
      ]) == 1
  end

  @doc "Whether something was claimed within the last `within_ms`."
  @spec claimed?(Names.gateway(), term(), pos_integer()) :: boolean()
  def claimed?(gateway, what, within_ms) do
    at = with_table(gateway, :claims, nil, &:ets.lookup_element(&1, what, 2, nil))
    at != nil and System.monotonic_time(:millisecond) - at < within_ms
  end

  @doc """
  Remembers that a system was heard, vehicle or not. At most #{@max_systems} are kept; a further one is counted as
  `{:systems, :dropped}` and not kept.
  """
  @spec see_system(Names.gateway(), vehicle_key(), map()) :: :ok | {:error, :too_many}
  def see_system(gateway, key, what) do
    table = table!(gateway, :systems)

    if :ets.info(table, :size) < @max_systems or :ets.member(table, key) do
      :ets.insert(table, {key, what})
      :ok
    else
      count(gateway, {:systems, :dropped})
      {:error, :too_many}
    end
  end

  @doc "The notes about a system; nil if it was not heard."
  @spec system(Names.gateway(), vehicle_key()) :: map() | nil
  def system(gateway, key) do
    with_table(gateway, :systems, nil, &:ets.lookup_element(&1, key, 2, nil))
  end

  @doc "All systems heard, with what was remembered about them."
  @spec systems(Names.gateway()) :: %{vehicle_key() => map()}
  def systems(gateway) do
    Map.new(with_table(gateway, :systems, [], &:ets.tab2list/1))
  end

  @doc "Keeps a value for a part of the gateway that needs it after its own restart."
  @spec remember(Names.gateway(), term(), term()) :: :ok
  def remember(gateway, key, value) do
    :ets.insert(table!(gateway, :notes), {key, value})
    :ok
  end

  @doc "Forgets a value."
  @spec forget(Names.gateway(), term()) :: :ok
  def forget(gateway, key) do
    :ets.delete(table!(gateway, :notes), key)
    :ok
  end

  @doc "The value that is kept under a key, or `absent`."
  @spec recall(Names.gateway(), term(), absent) :: term() | absent when absent: term()
  def recall(gateway, key, absent \\ nil),
    do: with_table(gateway, :notes, absent, &:ets.lookup_element(&1, key, 2, absent))

  @doc "The gateway is not ready before this process has ended."
  @spec starting(Names.gateway(), pid()) :: :ok
  def starting(gateway, pid), do: remember(gateway, :starting, pid)

  @doc "Whether there is such a process."
  @spec starting?(Names.gateway()) :: boolean()
  def starting?(gateway),
    do: with(pid when is_pid(pid) <- recall(gateway, :starting, false), do: Process.alive?(pid))

  @doc "All values that are kept, in the order of their keys."
  @spec remembered(Names.gateway()) :: [{term(), term()}]
  def remembered(gateway), do: Enum.sort(with_table(gateway, :notes, [], &:ets.tab2list/1))

  @doc false
  # For the modules that keep a table here.
  @spec table!(Names.gateway(), atom()) :: :ets.table()
  def table!(gateway, name) do
    case Names.held(gateway, :store) do
      %{^name => table} -> table
      nil -> raise ArgumentError, "gateway #{inspect(gateway)} is not running"
    end
  end

  @doc false
  # The result of one ETS call on a table, or `absent`. It does nothing else, so that no other error is mistaken for a missing table.
  @spec with_table(Names.gateway(), atom(), result, (:ets.table() -> result)) :: result when result: term()
  def with_table(gateway, name, absent, fun) do
    case Names.held(gateway, :store) do
      %{^name => table} -> fun.(table)
      nil -> absent
    end
  rescue
    # The store ended between finding its table and reading it.
    error in ArgumentError ->
      if Names.whereis(gateway, :store), do: reraise(error, __STACKTRACE__), else: absent
  end

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:store, gateway})

    # Links ask for the sizes of some. With decentralized counters, an ordered set's default, that waits for all schedulers.
    shared = [:public, read_concurrency: true, write_concurrency: true, decentralized_counters: false]

    tables = %{
      vehicles: :ets.new(:vehicles, [:set | shared]),
      vehicle_keys: :ets.new(:vehicle_keys, [:set | shared]),
      links: :ets.new(:links, [:set | shared]),
      link_rows: :ets.new(:link_rows, [:ordered_set | shared]),
      counters: :ets.new(:counters, [:set, :public, write_concurrency: true, decentralized_counters: true]),
      systems: :ets.new(:systems, [:set | shared]),
      stations: :ets.new(:stations, [:ordered_set | shared]),
      claims: :ets.new(:claims, [:set | shared]),
      notes: :ets.new(:notes, [:set | shared])
    }

    true = :ets.insert(tables.counters, for(counter <- options[:counters] || [], do: {counter, 0}))
    Names.put_held(gateway, :store, Enum.into(options[:tables] || [], tables, &create/1))
    {:ok, gateway}
  end

  defp create({name, options, objects}) do
    table = :ets.new(name, [:public | options])
    true = :ets.insert(table, objects)
    {name, table}
  end

  @impl GenServer
  # The answer that a watchdog waits for.
  def handle_info({:watchdog, watchdog, tag}, gateway) do
    send(watchdog, {:alive, tag, self()})
    {:noreply, gateway}
  end
end
