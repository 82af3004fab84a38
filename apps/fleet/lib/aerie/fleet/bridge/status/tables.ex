defmodule Aerie.Fleet.Bridge.Status.Tables do
  @moduledoc """
  Owns the tables that the bridge's processes share and that must outlive them: state values that wait for NATS, counters,
  and the status of the parts. It does nothing else, so it has no reason to crash.

  * `values`: `{subject, body, label}` not published yet, and `{{:dirty, subject}}` if the publisher was notified
  * `sent`: `{subject, message, ms}`, the message last sent on each subject and when (monotonic)
  * `counters`: `{{metric, labels}, n}`
  * `info`: `{:server, map}`, `{:connection, map}`, `{:streams, map}`, `{:outbox, map}`; on a leaf node
    `{:leaf, map}` (what the server says of the hub) and `{:hub, map}`
  """
  use GenServer

  alias Aerie.Fleet.Bridge.Status.Readiness
  alias Aerie.Base.Names

  @type t :: %{values: :ets.table(), sent: :ets.table(), counters: :ets.table(), info: :ets.table()}

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :bridge_tables))
  end

  @doc "The tables of a gateway's bridge, or nil if it is not running."
  @spec get(Names.gateway()) :: t() | nil
  def get(gateway), do: Names.value(gateway, :bridge_tables)

  @doc "Adds to a counter."
  @spec count(t(), atom(), [{atom(), String.t()}], integer()) :: :ok
  def count(tables, metric, labels \\ [], n \\ 1) do
    key = {metric, labels}
    _ = :ets.update_counter(tables.counters, key, n, {key, 0})
    :ok
  end

  @doc "The status of a part."
  @spec info(t(), :server | :connection | :streams | :outbox | :leaf | :hub) :: map()
  def info(tables, part), do: :ets.lookup_element(tables.info, part, 2, %{})

  @doc "Why NATS does not store events, or nil if it does."
  @spec problem(t()) :: String.t() | nil
  def problem(tables),
    do: Readiness.problem(Map.new([:server, :connection, :streams, :outbox], &{&1, info(tables, &1)}))

  @doc "Writes the status of a part and publishes it to subscribers of `:bridge`."
  @spec put_info(Names.gateway(), t(), :server | :connection | :streams | :outbox | :leaf | :hub, map()) ::
          :ok
  def put_info(gateway, tables, part, info) do
    :ets.insert(tables.info, {part, info})
    Aerie.Base.PubSub.publish(gateway, :bridge, {part, info})
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:bridge_tables, gateway})
    shared = [:set, :public, read_concurrency: true, write_concurrency: true]

    tables = %{
      values: :ets.new(:bridge_values, shared),
      sent: :ets.new(:bridge_sent, [:set, :public]),
      counters: :ets.new(:bridge_counters, [:set, :public, write_concurrency: true]),
      info: :ets.new(:bridge_info, shared)
    }

    Names.put_value(gateway, :bridge_tables, tables)
    {:ok, gateway}
  end
end
