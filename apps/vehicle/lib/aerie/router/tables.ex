defmodule Aerie.Router.Tables do
  @moduledoc """
  The router's ETS tables. `Aerie.Router.Supervisor` owns them (it runs no code of its own that could fail), everyone
  reads and writes them directly, and they are found through the supervisor's name.

  - `:routes` `{{network, system, component, owner, peer}, heard_ms, since_ms}`
  - `:endpoints` `{{owner, peer}, Endpoint}` and `:owners` `{owner, Owner}`: where frames can go, and by which rules
  - `:seen` what `Dedupe` remembers, `:limits` what `RateLimit` does
  - `:clients` `{id, snapshot}` of client endpoints, `:scores` what `Meter` measured
  - `:load` `{vehicle_key, checked_ms, overloaded?}`
  - `:refused` `{vehicle_key, until_ms}`
  - `:settings` `{name, value}`, `{{:network, name}, order in which it came}`

  `generation` is a counter that moves whenever an endpoint, an owner or the set of ways to a system changes. Processes
  that forward keep what they worked out from these tables for as long as it stands still. `id` tells them from the tables
  of an earlier life.
  """

  alias Aerie.Names

  @type t :: %{
          routes: :ets.table(),
          endpoints: :ets.table(),
          owners: :ets.table(),
          seen: {:ets.table(), :ets.table()},
          limits: :ets.table(),
          clients: :ets.table(),
          scores: :ets.table(),
          load: :ets.table(),
          refused: :ets.table(),
          settings: :ets.table(),
          generation: :atomics.atomics_ref(),
          id: reference
        }

  @doc "Makes the tables, owned by the calling process, whose name is `{gateway, :router, nil}`."
  @spec create(Names.gateway(), keyword) :: t
  def create(gateway, settings) do
    shared = [:public, write_concurrency: true, read_concurrency: true]

    tables = %{
      # Ordered, so that all routes of a system or a component are one range.
      routes: :ets.new(:routes, [:ordered_set | shared]),
      endpoints: :ets.new(:endpoints, [:set | shared]),
      owners: :ets.new(:owners, [:set | shared]),
      seen: {:ets.new(:seen, [:set | shared]), :ets.new(:seen, [:set | shared])},
      limits: :ets.new(:limits, [:set | shared]),
      clients: :ets.new(:clients, [:set | shared]),
      scores: :ets.new(:scores, [:set | shared]),
      load: :ets.new(:load, [:set | shared]),
      refused: :ets.new(:refused, [:set | shared]),
      settings: :ets.new(:settings, [:set, :public, read_concurrency: true]),
      generation: :atomics.new(2, signed: false),
      id: make_ref()
    }

    :ets.insert(tables.settings, [{:seen_turn, {0, System.monotonic_time(:millisecond)}} | settings])
    Names.put_value(gateway, :router, tables)
    tables
  end

  @doc "The tables of a gateway, nil when its router is not running."
  @spec of(Names.gateway()) :: t | nil
  def of(gateway), do: Names.held(gateway, :router)

  @doc "A setting."
  @spec setting(t, term, default) :: term | default when default: term
  def setting(tables, name, default), do: :ets.lookup_element(tables.settings, name, 2, default)

  @doc "Tells every process that forwards to look again."
  @spec changed(t) :: :ok
  def changed(tables), do: :atomics.add(tables.generation, 1, 1)

  @doc "The generation just now."
  @spec generation(t) :: non_neg_integer
  def generation(tables), do: :atomics.get(tables.generation, 1)

  @doc "Tells every process that forwards that somebody is heard by one more endpoint."
  @spec rerouted(t) :: :ok
  def rerouted(tables), do: :atomics.add(tables.generation, 2, 1)

  @doc "How often that was told."
  @spec routed(t) :: non_neg_integer
  def routed(tables), do: :atomics.get(tables.generation, 2)
end
