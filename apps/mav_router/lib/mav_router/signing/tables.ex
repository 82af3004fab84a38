defmodule MavRouter.Signing.Tables do
  @moduledoc """
  The ETS tables that links, sessions and interfaces share for signing, owned by `MavRouter.Signing.Supervisor` and found through its name.

  - `:scopes` `{scope id, MavRouter.Signing.Scope}`
  - `:verifiers` `{{link, scope id}, generation, MavCodec.Signing}`: written only by the link's process
  - `:stored` `{{link, scope id}, link id, time stamp, streams}`: what the former process left
  - `:reserved` `{{link, scope id}, time stamp}`: what a later process must not fall behind (S6)
  - `:sources` `{vehicle key, verified_us, unsigned_us, verified, unsigned, rejected}`
  - `:bursts` `{{link, system, component}, MavRouter.Signing.Alarm.burst()}`
  - `:announced` `{{link, peer, scope id}, monotonic ms}` (`MavRouter.Signing.Admission.ClockRecovery`)
  - `:waiters` `{vehicle key, pid, reference}`: enrolments that wait for a signed frame
  - `:candidates` `{vehicle key, MavRouter.Signing.Scope}`: keys that vehicles may have been given, not yet proven
  - `:proven` `{{link, peer}, [{scope id, monotonic s}]}`: the keys that a peer has (`MavRouter.Signing.Signer`)
  - `:newest` `{{network, link id, system, component}, time stamp}`: the last one of a stream by any link
  - `:settings` `{name, value}`

  `active` is 1 while there is a scope or candidate: without one, a read costs one look at it.
  """

  alias Aerie.Base.Names
  alias MavRouter.Signing.Scope

  @type t :: %{
          scopes: :ets.table(),
          verifiers: :ets.table(),
          stored: :ets.table(),
          reserved: :ets.table(),
          sources: :ets.table(),
          bursts: :ets.table(),
          announced: :ets.table(),
          waiters: :ets.table(),
          candidates: :ets.table(),
          proven: :ets.table(),
          newest: :ets.table(),
          settings: :ets.table(),
          events: module | nil,
          active: :atomics.atomics_ref()
        }

  @doc """
  Makes the tables, owned by the calling process, whose name is `{gateway, :signing, nil}`. `events` is the module of
  `MavRouter.Signing.Events`.
  """
  @spec create(Names.gateway(), keyword, module | nil) :: t
  def create(gateway, settings, events \\ nil) do
    shared = [:set, :public, read_concurrency: true, write_concurrency: true]

    tables =
      ([:scopes, :verifiers, :stored, :reserved, :sources, :bursts, :announced, :waiters, :settings] ++
         [:candidates, :proven, :newest])
      |> Map.new(&{&1, :ets.new(&1, shared)})
      |> Map.put(:events, events)
      |> Map.put(:active, :atomics.new(1, signed: false))

    :ets.insert(tables.settings, settings)
    Names.put_held(gateway, :signing, tables)
    tables
  end

  @doc "The tables of a gateway; nil when it does not sign."
  @spec of(Names.gateway()) :: t | nil
  def of(gateway), do: Names.held(gateway, :signing)

  @doc "The same, nil too when there is no key."
  @spec active(Names.gateway()) :: t | nil
  def active(gateway) do
    with %{active: active} = tables <- of(gateway), do: if(:atomics.get(active, 1) == 1, do: tables)
  end

  @doc "The clock of signatures, in unix microseconds; tests put one of their own in its place."
  @spec clock(t()) :: (-> integer())
  def clock(tables), do: setting(tables, :clock, fn -> System.os_time(:microsecond) end)

  @doc "A setting."
  @spec setting(t, atom, default) :: term | default when default: term
  def setting(tables, name, default), do: :ets.lookup_element(tables.settings, name, 2, default)

  @doc "The scope that a system belongs to, nil when there is no key for it."
  @spec scope(t, {String.t(), non_neg_integer | nil}) :: Scope.t() | nil
  def scope(tables, {network, system}) do
    with nil <- :ets.lookup_element(tables.scopes, {network, system}, 2, nil),
         do: :ets.lookup_element(tables.scopes, {network, :any}, 2, nil)
  end

  @doc "The key that a vehicle may have been given and has not proven yet."
  @spec candidate(t, {String.t(), non_neg_integer}) :: Scope.t() | nil
  def candidate(tables, key) do
    if :ets.info(tables.candidates, :size) > 0, do: :ets.lookup_element(tables.candidates, key, 2, nil)
  end

  @doc "Adds a scope, or replaces the one with its id."
  @spec put_scope(t, Scope.t()) :: :ok
  def put_scope(tables, scope) do
    :ets.insert(tables.scopes, {scope.id, scope})
    activate(tables)
  end

  @doc "Removes a scope."
  @spec delete_scope(t, Scope.id()) :: :ok
  def delete_scope(tables, id) do
    :ets.delete(tables.scopes, id)
    activate(tables)
  end

  @doc "Sets the candidate of a vehicle; nil for none."
  @spec put_candidate(t, Scope.id(), Scope.t() | nil) :: :ok
  def put_candidate(tables, id, nil) do
    :ets.delete(tables.candidates, id)
    activate(tables)
  end

  def put_candidate(tables, id, scope) do
    :ets.insert(tables.candidates, {id, scope})
    activate(tables)
  end

  defp activate(tables) do
    any = :ets.info(tables.scopes, :size) + :ets.info(tables.candidates, :size)
    :atomics.put(tables.active, 1, min(any, 1))
  end
end
