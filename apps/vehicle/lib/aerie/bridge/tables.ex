defmodule Aerie.Bridge.Tables do
  @moduledoc """
  Owns what the bridge's processes share and what must outlive them: last values of state waiting for NATS, counters, and
  what is known of the server and the connection. It does nothing else, so nothing can end it.

  * `values`: `{subject, body, label}` not published yet, and `{{:dirty, subject}}` for those that the publisher was told of
  * `sent`: `{subject, message, ms}`, the message last sent on each subject and when (monotonic)
  * `counters`: `{{metric, labels}, n}`
  * `info`: `{:server, map}`, `{:connection, map}`, `{:streams, map}`, `{:outbox, map}`
  """
  use GenServer

  alias Aerie.Bridge.Problem
  alias Aerie.Names

  @type t :: %{values: :ets.table(), sent: :ets.table(), counters: :ets.table(), info: :ets.table()}

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :bridge_tables))
  end

  @doc "The tables of a gateway's bridge, or nil when it is not running."
  @spec get(Names.gateway()) :: t() | nil
  def get(gateway), do: Names.value(gateway, :bridge_tables)

  @doc "Adds to a counter."
  @spec count(t(), atom(), [{atom(), String.t()}], integer()) :: :ok
  def count(tables, metric, labels \\ [], n \\ 1) do
    key = {metric, labels}
    _ = :ets.update_counter(tables.counters, key, n, {key, 0})
    :ok
  end

  @doc "What is known of a part."
  @spec info(t(), :server | :connection | :streams | :outbox) :: map()
  def info(tables, part), do: :ets.lookup_element(tables.info, part, 2, %{})

  @doc "What keeps events from being stored by NATS, or nil."
  @spec problem(t()) :: String.t() | nil
  def problem(tables),
    do: Problem.text(Map.new([:server, :connection, :streams, :outbox], &{&1, info(tables, &1)}))

  @doc "Writes what is known of a part, and tells subscribers of `:bridge` what it is now."
  @spec put_info(Names.gateway(), t(), :server | :connection | :streams | :outbox, map()) :: :ok
  def put_info(gateway, tables, part, info) do
    :ets.insert(tables.info, {part, info})
    Aerie.Store.PubSub.publish(gateway, :bridge, {part, info})
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
