defmodule Aerie.Fleet.Tracks.Metrics do
  @moduledoc """
  The tracks' counters in the read model (`gateway_occurrences_total`), how they are, and their telemetry:

  | event | measurements | metadata | when |
  |---|---|---|---|
  | `[:aerie, :tracks, :failing]` | `count` (1) | `gateway`, `reason` | they cannot be written any more |
  """

  alias Aerie.Base.{Names, Store}

  @typedoc "nil: the part does not run. `bytes`: of all files."
  @type status :: :off | %{dir: Path.t(), bytes: non_neg_integer(), problem: String.t() | nil} | nil

  @doc "The counters: samples and bytes written, samples lost, files that made room before their time."
  @spec counters() :: [tuple()]
  def counters, do: for(what <- [:samples, :bytes, :lost, :made_room], do: {:tracks, what})

  @spec count(Names.gateway(), atom(), pos_integer()) :: :ok
  def count(gateway, what, n) do
    _ = Store.count(gateway, {:tracks, what}, n)
    :ok
  end

  @spec written(Names.gateway(), samples :: pos_integer(), bytes :: pos_integer(), early :: non_neg_integer()) ::
          :ok
  def written(gateway, samples, bytes, early) do
    count(gateway, :samples, samples)
    count(gateway, :bytes, bytes)
    if early > 0, do: count(gateway, :made_room, early), else: :ok
  end

  @spec failing(Names.gateway(), String.t()) :: :ok
  def failing(gateway, reason),
    do: :telemetry.execute([:aerie, :tracks, :failing], %{count: 1}, %{gateway: gateway, reason: reason})

  @doc "Says how they are."
  @spec status(Names.gateway(), status()) :: :ok
  def status(gateway, status) do
    true = :ets.insert(Store.table!(gateway, :tracks), {:status, status})
    :ok
  end

  @doc "How they are."
  @spec status(Names.gateway()) :: status()
  def status(gateway), do: Store.with_table(gateway, :tracks, nil, &:ets.lookup_element(&1, :status, 2, nil))
end
