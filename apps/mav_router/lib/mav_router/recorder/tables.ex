defmodule MavRouter.Recorder.Tables do
  @moduledoc """
  The ETS tables that the recorder's parts share, owned by `MavRouter.Recorder.Supervisor` and found through its name.

  - `:taps` (a bag) `{target, pid, counters, limit}`: who gets a target's frames
  - `:ring` (ordered) `{{vehicle key, n}, monotonic ms, bytes, records, frames}` and `:rings` `{vehicle key, last n, bytes}`
  - `:wanted` `{target, mode}`: modes requested at run time, which replace the configured ones
  - `:status` `{target, status}`
  - `:notes` `{name, value}`: the space that is left, and what was logged

  Beside them stand the `:settings`, which do not change.

  A target is `{:link, id}`, `{:vehicle, {network, system}}` or, while a ring is being saved, `{:saved, {network, system}}`.
  """

  alias Aerie.Base.Names
  alias MavRouter.Recorder.Settings

  @type target ::
          {:link, String.t()}
          | {:vehicle | :saved, {String.t(), non_neg_integer}}
  @type mode :: :off | :armed | :always
  @type t :: %{
          taps: :ets.table(),
          ring: :ets.table(),
          rings: :ets.table(),
          wanted: :ets.table(),
          status: :ets.table(),
          notes: :ets.table(),
          settings: Settings.t()
        }

  @doc "Makes the tables, owned by the calling process, whose name is `{gateway, :recorder, nil}`."
  @spec create(Names.gateway(), Settings.t()) :: t
  def create(gateway, settings) do
    shared = [:public, read_concurrency: true]

    tables = %{
      taps: :ets.new(:taps, [:bag | shared]),
      ring: :ets.new(:ring, [:ordered_set, :public, write_concurrency: true]),
      rings: :ets.new(:rings, [:set, :public, write_concurrency: true]),
      wanted: :ets.new(:wanted, [:set | shared]),
      status: :ets.new(:status, [:set | shared]),
      notes: :ets.new(:notes, [:set | shared]),
      settings: settings
    }

    Names.put_held(gateway, :recorder, tables)
    tables
  end

  @doc "The tables of a gateway; nil when it has no recorder."
  @spec of(Names.gateway()) :: t | nil
  def of(gateway), do: Names.held(gateway, :recorder)

  @doc "The settings."
  @spec settings(t) :: Settings.t()
  def settings(tables), do: tables.settings

  @doc "The recording mode of a target."
  @spec mode(t, target) :: mode
  def mode(tables, {kind, _id} = target) do
    case :ets.lookup(tables.wanted, target) do
      [{_target, mode}] -> mode
      [] -> tables |> settings() |> Map.fetch!(if(kind == :link, do: :links, else: :vehicles))
    end
  end
end
