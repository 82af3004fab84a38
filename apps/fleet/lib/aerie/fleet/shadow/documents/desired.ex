defmodule Aerie.Fleet.Shadow.Documents.Desired do
  @moduledoc """
  The desired documents: in memory, on disk and in the bucket, brought to the same version. Functions of the state of
  `Aerie.Fleet.Shadow.Documents.Server`, their only caller.
  """

  alias Aerie.Fleet.Shadow.{Document, Metrics}
  alias Aerie.Fleet.Shadow.Document.{Sealed, Tags}
  alias Aerie.Fleet.Shadow.Store.{Buckets, LocalStore}
  alias Aerie.Base.Store
  alias Aerie.Base.PubSub

  require Logger

  @log_ms 5_000

  @type state :: map()

  @doc "The document in memory; an empty one if there is none."
  @spec known(state(), String.t()) :: Document.t()
  def known(state, vehicle),
    do: :ets.lookup_element(state.table, {:document, vehicle}, 2, Document.new(vehicle))

  @doc "Loads a vehicle's document: the copy on disk first, then the document in NATS."
  @spec load(state(), String.t()) :: state()
  def load(state, vehicle) do
    state = if :ets.member(state.table, {:document, vehicle}), do: state, else: load_copy(state, vehicle)
    if state.conn, do: load_kept(state, vehicle), else: state
  end

  defp load_copy(%{kept: kept} = state, vehicle) do
    with text when is_binary(text) <- LocalStore.read(state.dir, vehicle),
         {kind, %Document{} = document} <- Sealed.decode(text, kept.environment, vehicle, kept.keys) do
      :ets.insert(state.table, {{:document, vehicle}, document})
      state = if kind == :former, do: copy(state, document), else: state
      tagged(state, document)
    else
      {:error, why} -> problem(state, "the copy of #{vehicle}'s desired state is not used: #{why}")
      nil -> state
    end
  end

  defp load_kept(state, vehicle) do
    case Buckets.read(state.conn, state.kept, vehicle) do
      {:ok, document, revision} -> document |> newer(state, revision) |> accept(document)
      {:none, revision} -> restore(state, vehicle, revision)
      {:refused, why, _revision} -> refused(state, vehicle, why)
      {:error, _why} -> state
    end
  end

  # The bucket's document is older than ours, for example after a restored backup.
  defp newer(document, state, revision) do
    if document.version < known(state, document.vehicle).version,
      do: restore(state, document.vehicle, revision),
      else: state
  end

  defp restore(state, vehicle, revision) do
    document = known(state, vehicle)

    _lost_race_or_later =
      if document.version > 0, do: Buckets.write(state.conn, state.kept, document, revision)

    state
  end

  @doc "Keeps a document that is newer than the one in memory, and gives it to the vehicle's loop."
  @spec accept(state(), Document.t()) :: state()
  def accept(state, document) do
    known = known(state, document.vehicle)

    cond do
      document.version > known.version ->
        :ets.insert(state.table, {{:document, document.vehicle}, document})
        if loop = state.loops[document.vehicle], do: send(loop, {:desired, document})
        state |> tagged(document) |> copy(document)

      document.version < known.version ->
        Metrics.count(state.gateway, :documents_refused)
        state

      true ->
        state
    end
  end

  defp copy(%{kept: kept} = state, document) do
    text = Sealed.encode(document, kept.environment, kept.keys)

    case LocalStore.write(state.dir, document.vehicle, text) do
      :ok -> state
      {:error, why} -> problem(state, why)
    end
  end

  @doc "Keeps only the tags of a document. The fleet's pages and groups need those of all vehicles, remote ones too."
  @spec tagged(state(), Document.t()) :: state()
  def tagged(state, document) do
    if Tags.note(state.table, document), do: PubSub.changed(state.gateway, {:vehicle, document.vehicle})
    state
  end

  @doc "Handles a change in the bucket. "
  @spec changed(state(), String.t(), {:put, binary()} | :removed) :: state()
  def changed(state, vehicle, change) do
    heard_here? = is_map_key(state.loops, vehicle)

    case change do
      {:put, value} -> received(state, vehicle, value, heard_here?)
      # Somebody else removed it: a gateway would leave an empty document.
      :removed when heard_here? and state.conn != nil -> load_kept(state, vehicle)
      :removed -> state
    end
  end

  defp received(state, vehicle, value, heard_here?) do
    case Sealed.decode(value, state.kept.environment, vehicle, state.kept.keys) do
      {:ok, document} when heard_here? -> accept(state, document)
      {:ok, document} -> tagged(state, document)
      {:former, document} -> former(state, document, heard_here?)
      {:error, why} when heard_here? -> refused(state, vehicle, why)
      {:error, _no_gateway_of_ours} -> state
    end
  end

  # Reading it seals it again.
  defp former(state, document, heard_here?) do
    _ = if state.conn, do: Buckets.read(state.conn, state.kept, document.vehicle)
    if heard_here?, do: accept(state, document), else: tagged(state, document)
  end

  defp refused(state, vehicle, why) do
    Metrics.count(state.gateway, :documents_refused)
    problem(state, "the desired state of #{vehicle} in NATS is not heeded: #{why}")
  end

  @doc """
  Records what keeps documents from being kept, nil for nothing. It is logged at most every five seconds, so that invalid
  documents do not flood the log.
  """
  @spec problem(state(), String.t() | nil) :: state()
  def problem(%{problem: problem} = state, problem), do: state

  def problem(state, problem) do
    if problem != nil and Store.claim(state.gateway, {__MODULE__, :problem}, @log_ms),
      do: Logger.warning("shadow: " <> problem)

    put_problem(state, problem)
  end

  @doc "Records that NATS is away. The bridge logs that."
  @spec away(state()) :: state()
  def away(state), do: put_problem(state, "NATS is away")

  defp put_problem(state, problem) do
    :ets.insert(state.table, {:problem, problem})
    %{state | problem: problem}
  end
end
