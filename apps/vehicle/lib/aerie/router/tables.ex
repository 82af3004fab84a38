defmodule Aerie.Router.Tables do
  @moduledoc """
  The router's ETS tables. `Aerie.Router.Supervisor` owns them (it runs no code of its own that could fail), everyone
  reads and writes them directly, and they are found through the supervisor's name.

  - `:routes` `{{network, system, component, link, peer}, heard_ms, since_ms}`
  - `:load` `{vehicle_key, checked_ms, overloaded?}`
  - `:refused` `{vehicle_key, until_ms}`
  - `:settings` `{name, value}`
  """

  alias Aerie.Names

  @type t :: %{routes: :ets.table(), load: :ets.table(), refused: :ets.table(), settings: :ets.table()}

  @doc "Makes the tables, owned by the calling process, whose name is `{gateway, :router, nil}`."
  @spec create(Names.gateway(), keyword) :: t
  def create(gateway, settings) do
    shared = [:public, write_concurrency: true, read_concurrency: true]

    tables = %{
      # Ordered, so that all routes of a system or a component are one range.
      routes: :ets.new(:routes, [:ordered_set | shared]),
      load: :ets.new(:load, [:set | shared]),
      refused: :ets.new(:refused, [:set | shared]),
      settings: :ets.new(:settings, [:set, :public, read_concurrency: true])
    }

    :ets.insert(tables.settings, settings)
    Names.put_value(gateway, :router, tables)
    tables
  end

  @doc "The tables of a gateway, nil when its router is not running."
  @spec of(Names.gateway()) :: t | nil
  def of(gateway), do: Names.value(gateway, :router)

  @doc "A setting."
  @spec setting(t, atom, default) :: term | default when default: term
  def setting(tables, name, default), do: :ets.lookup_element(tables.settings, name, 2, default)
end
