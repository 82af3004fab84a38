defmodule MavRouter.Tables do
  @max_changes 1_024

  @moduledoc """
  The router's ETS tables. `MavRouter.Router.Supervisor` owns them (it runs no code of its own that could fail); everyone reads and
  writes them directly and finds them through the supervisor's name.

  - `:routes` `{{network, system, component, owner, peer}, heard_ms, since_ms}`
  - `:endpoints` `{{owner, peer}, Endpoint}` and `:owners` `{owner, Owner}`: where frames can go, and by which rules
  - `:seen` for `Dedupe`, `:limits` for `RateLimit`
  - `:obeyed` `{vehicle_key, lowest, highest, noted_ms}`: ids that a vehicle takes for its station's (`GroundStations`)
  - `:clients` `{id, snapshot}` of client endpoints; `:scores` what `Meter` measured
  - `:load` `{vehicle_key, checked_ms, overloaded?}`
  - `:refused` `{vehicle_key, until_ms}`: vehicles for which there was no room
  - `:waiting` `{vehicle_key, sender, number}`: vehicles that are being started (`MavRouter.Router.Starter`); `:early` `{{vehicle_key, number}, frames}`: what
    came of them so far, in order
  - `:settings` `{name, value}`, `{{:network, name}, order in which it came}`, `{{:starts, owner}, token bucket}`
  - `:changes` `{generation, endpoint's key | :all}`: what moved the generation, the last #{@max_changes} times
  - `:heard_by` `{{owner, peer, network, system, component}}`: the routes, by endpoint
  - `:holders` `{vehicle_key, members, kind, claimed_ms}` of `MavRouter.Forward.Holders`

  `generation` counts two things: changes of endpoints and owners, and changes of routes that concern others. Forwarding processes
  keep what they worked out from these tables for as long as it stands still. `id` tells the tables from those before a restart.
  """

  alias Aerie.Base.Names

  @type t :: %{
          routes: :ets.table(),
          heard_by: :ets.table(),
          holders: :ets.table(),
          changes: :ets.table(),
          endpoints: :ets.table(),
          owners: :ets.table(),
          seen: {:ets.table(), :ets.table()},
          limits: :ets.table(),
          obeyed: :ets.table(),
          clients: :ets.table(),
          scores: :ets.table(),
          load: :ets.table(),
          refused: :ets.table(),
          waiting: :ets.table(),
          early: :ets.table(),
          settings: :ets.table(),
          vehicles: module | nil,
          requests: module | nil,
          policy: module | nil,
          readings: module | nil,
          generation: :atomics.atomics_ref(),
          id: reference
        }

  @doc """
  Makes the tables, owned by the calling process, whose name is `{gateway, :router, nil}`. `:vehicles`, `:requests`,
  `:policy` and `:readings` are the modules of `MavRouter.Router.Vehicles`, `MavRouter.Sharing.StreamRequests`,
  `MavRouter.Router.Policy` and `MavRouter.Sharing.ReadCache`.
  """
  @spec create(Names.gateway(), keyword, keyword) :: t
  def create(gateway, settings, modules \\ []) do
    # Links ask for the sizes of some. With decentralized counters, an ordered set's default, that waits for all schedulers.
    shared = [:public, write_concurrency: true, read_concurrency: true, decentralized_counters: false]

    tables = %{
      # Ordered, so that all routes of a system or a component are one range.
      routes: :ets.new(:routes, [:ordered_set | shared]),
      heard_by: :ets.new(:heard_by, [:ordered_set | shared]),
      holders: :ets.new(:holders, [:set | shared]),
      changes: :ets.new(:changes, [:set | shared]),
      endpoints: :ets.new(:endpoints, [:set | shared]),
      owners: :ets.new(:owners, [:set | shared]),
      seen: {:ets.new(:seen, [:set | shared]), :ets.new(:seen, [:set | shared])},
      # Ordered, so that all limits of an endpoint are one range.
      limits: :ets.new(:limits, [:ordered_set | shared]),
      obeyed: :ets.new(:obeyed, [:set | shared]),
      clients: :ets.new(:clients, [:set | shared]),
      scores: :ets.new(:scores, [:set | shared]),
      load: :ets.new(:load, [:set | shared]),
      refused: :ets.new(:refused, [:set | shared]),
      waiting: :ets.new(:waiting, [:set | shared]),
      # Ordered, so that all frames of a vehicle are one range.
      early: :ets.new(:early, [:ordered_set | shared]),
      settings: :ets.new(:settings, [:set, :public, read_concurrency: true]),
      vehicles: modules[:vehicles],
      requests: modules[:requests],
      policy: modules[:policy],
      readings: modules[:readings],
      generation: :atomics.new(2, signed: false),
      id: make_ref()
    }

    :ets.insert(tables.settings, [{:seen_turn, {0, System.monotonic_time(:millisecond)}} | settings])
    Names.put_held(gateway, :router, tables)
    tables
  end

  @doc "The tables of a gateway, nil when its router is not running."
  @spec of(Names.gateway()) :: t | nil
  def of(gateway), do: Names.held(gateway, :router)

  @doc "A setting."
  @spec setting(t, term, default) :: term | default when default: term
  def setting(tables, name, default), do: :ets.lookup_element(tables.settings, name, 2, default)

  @doc "The snapshot of a client endpoint, nil for an unknown one."
  @spec client(Names.gateway(), String.t()) :: map | nil
  def client(gateway, id) do
    with %{clients: clients} <- of(gateway), do: :ets.lookup_element(clients, id, 2, nil)
  end

  @doc """
  Has every forwarding process read again: one endpoint, or all of them and their owners' rules. Called after the change is in the
  tables.
  """
  @spec changed(t, MavRouter.Endpoints.Endpoint.key() | :all) :: :ok
  def changed(tables, what \\ :all) do
    generation = :atomics.add_get(tables.generation, 1, 1)
    true = :ets.insert(tables.changes, {generation, what})
    true = :ets.delete(tables.changes, generation - @max_changes)
    :ok
  end

  @doc """
  The endpoints that changed after one generation and up to another. `:all` when more than endpoints changed, when it was too long
  ago, or when the process that made a change has not said which yet.
  """
  @spec changes(t, non_neg_integer, non_neg_integer) :: [MavRouter.Endpoints.Endpoint.key()] | :all
  def changes(_tables, from, to) when to - from > div(@max_changes, 4), do: :all

  def changes(tables, from, to) do
    changes =
      for generation <- (from + 1)..to//1, do: :ets.lookup_element(tables.changes, generation, 2, :all)

    if :all in changes, do: :all, else: Enum.uniq(changes)
  end

  @doc "The present generation."
  @spec generation(t) :: non_neg_integer
  def generation(tables), do: :atomics.get(tables.generation, 1)

  @doc "Has every forwarding process work out the receivers of its sources again: routes have changed."
  @spec rerouted(t) :: :ok
  def rerouted(tables), do: :atomics.add(tables.generation, 2, 1)

  @doc "How often `rerouted/1` was called."
  @spec routed(t) :: non_neg_integer
  def routed(tables), do: :atomics.get(tables.generation, 2)
end
