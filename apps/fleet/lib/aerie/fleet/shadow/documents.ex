defmodule Aerie.Fleet.Shadow.Documents do
  @moduledoc """
  The desired documents of the vehicles that this gateway hears, the state of their fields, and whether this gateway may
  act on them.

  `Aerie.Fleet.Shadow.Documents.Server` keeps them. Loops join with their vehicle, and get `{:desired, document}` at
  once and with every change. Readers use its table. Updates are written in the caller's process (`change/3`), so none
  waits for another; the server is only notified.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Shadow.{Document, Metrics}
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Fleet.Shadow.Document.Tags
  alias Aerie.Fleet.Shadow.Store.Buckets

  # For how long an answer waits to be shown here.
  @shown_ms 1_000
  # The change is made however long it takes: a client that got "try again" would make it twice.
  @change_ms 30_000

  ## For loops

  @doc "Joins the loop of a vehicle: it gets the documents from now on."
  @spec join(pid(), String.t()) :: :ok
  def join(documents, vehicle), do: GenServer.cast(documents, {:join, vehicle, self()})

  @doc "Tells whether the vehicle is heard: only then does this gateway claim it."
  @spec vehicle_heard(pid(), String.t(), boolean()) :: :ok
  def vehicle_heard(documents, vehicle, heard?), do: GenServer.cast(documents, {:heard, vehicle, heard?})

  @doc "Sets the state of a vehicle's fields and its reported document, which are shown and published."
  @spec report(pid(), String.t(), Aerie.Fleet.Shadow.Loop.Reconcile.report(), map()) :: :ok
  def report(documents, vehicle, fields, reported),
    do: GenServer.cast(documents, {:report, vehicle, fields, reported})

  @doc "Whether this gateway may act on a vehicle now; if not, what prevents it."
  @spec authority(Names.gateway(), String.t()) :: :mine | {:held, by :: String.t(), why :: String.t()}
  def authority(gateway, vehicle) do
    case row(gateway, {:authority, vehicle}) do
      {:mine, until} ->
        if System.monotonic_time(:millisecond) < until,
          do: :mine,
          else: {:held, "nats", "the lease could not be renewed in time"}

      {:other, name} ->
        {:held, "gateway", "the gateway #{name} acts on it"}

      {:held, by, why} ->
        {:held, by, why}

      nil ->
        {:held, "gateway", "it is not known yet which gateway acts on it"}
    end
  end

  @doc """
  The gateway that holds a vehicle (`Aerie.Control.Commands.Gateways`): by both clocks, because a machine that was
  suspended counts too little on one of them.
  """
  @spec holder(Names.gateway(), String.t()) :: Aerie.Control.Commands.Gateways.Sending.holder()
  def holder(gateway, vehicle), do: if(Bridge.off?(gateway), do: :alone, else: held(gateway, vehicle))

  defp held(gateway, vehicle) do
    case row(gateway, {:holder, vehicle}) do
      {:mine, until, wall} ->
        if System.os_time(:millisecond) < wall,
          do: {:mine, until},
          else: {:unknown, Refusal.text(:lease_due)}

      nil ->
        {:unknown, Refusal.text(:holder_not_known)}

      other ->
        other
    end
  end

  @doc "The name by which this gateway claims vehicles and commands; nil while the shadow does not run."
  @spec instance(Names.gateway()) :: String.t() | nil
  def instance(gateway), do: row(gateway, :instance)

  ## For readers and writers

  @doc "The desired document of a vehicle as known here, without asking NATS; version 0 if there is none."
  @spec document(Names.gateway(), String.t()) :: Document.t()
  def document(gateway, vehicle), do: row(gateway, {:document, vehicle}) || Document.new(vehicle)

  @doc "The state of a vehicle's fields and its reported document, from this gateway's loop, or nil."
  @spec reported(Names.gateway(), String.t()) :: {Aerie.Fleet.Shadow.Loop.Reconcile.report(), map()} | nil
  def reported(gateway, vehicle), do: row(gateway, {:reported, vehicle})

  @doc "The state of the fields of all vehicles."
  @spec reports(Names.gateway()) :: [Aerie.Fleet.Shadow.Loop.Reconcile.report()]
  def reports(gateway) do
    with_table(gateway, [], fn table ->
      for [fields] <- :ets.match(table, {{:reported, :_}, {:"$1", :_}}), do: fields
    end)
  end

  @doc "The tags of the vehicles whose documents this gateway has seen, heard here or not."
  @spec tags(Names.gateway()) :: Tags.tags()
  def tags(gateway), do: with_table(gateway, %{}, &Tags.of(&1, System.os_time(:microsecond)))

  @doc "Why desired states cannot be stored, or do not agree with the hub's; or nil."
  @spec problem(Names.gateway()) :: String.t() | nil
  def problem(gateway), do: row(gateway, :problem) || Names.value(gateway, :shadow_uplink)

  @doc "The document of a vehicle in NATS, also of one that this gateway does not hear."
  @spec fetch(Names.gateway(), String.t()) :: {:ok, Document.t()} | {:error, {:unavailable, String.t()}}
  def fetch(gateway, vehicle) do
    case place(gateway) do
      {:local, _kept} -> {:ok, document(gateway, vehicle)}
      {:nats, conn, kept} -> fetch(gateway, vehicle, conn, kept)
      error -> if document(gateway, vehicle).version > 0, do: {:ok, document(gateway, vehicle)}, else: error
    end
  end

  defp fetch(gateway, vehicle, conn, kept) do
    copy = document(gateway, vehicle)

    case Buckets.read(conn, kept, vehicle) do
      {:ok, document, _revision} -> {:ok, Enum.max_by([document, copy], & &1.version)}
      {:error, why} when copy.version == 0 -> {:error, {:unavailable, "NATS does not answer: #{why}"}}
      _none_or_refused -> {:ok, copy}
    end
  end

  @doc "Changes a vehicle's document by a function of the present one, and stores it."
  @spec change(Names.gateway(), String.t(), (Document.t() -> {:ok, Document.t()} | error)) ::
          {:ok, Document.t()} | error | {:error, {:unavailable, String.t()}}
        when error: {:error, {:role | :conflict | :limit, String.t()}}
  def change(gateway, vehicle, fun) do
    case place(gateway) do
      {:local, _kept} ->
        GenServer.call(Names.via(gateway, :shadow_documents), {:change, vehicle, fun}, @change_ms)

      {:nats, conn, kept} ->
        copy = document(gateway, vehicle)

        with {:ok, document} <-
               Buckets.change(conn, kept, copy, fun, fn -> Metrics.count(gateway, :conflicts) end) do
          written(gateway, document)
          {:ok, document}
        end

      error ->
        error
    end
  catch
    :exit, _gone ->
      {:error, {:unavailable, "the shadow is being restarted, or NATS does not answer; try again"}}
  end

  # A caller that has its answer finds the change in the gateway's state. If the process is busy with NATS, that follows
  # later.
  defp written(gateway, document) do
    GenServer.call(Names.via(gateway, :shadow_documents), {:written, document}, @shown_ms)
  catch
    :exit, _late -> :ok
  end

  @doc "Takes a token of the rate limit for an update by somebody; `:none` if they come too fast."
  @spec rate(Names.gateway(), actor :: String.t()) :: :ok | :none | {:error, {:unavailable, String.t()}}
  def rate(gateway, actor) do
    GenServer.call(Names.via(gateway, :shadow_documents), {:rate, actor})
  catch
    :exit, _gone -> {:error, {:unavailable, "the shadow does not answer; try again"}}
  end

  # Where documents are stored now.
  defp place(gateway) do
    case Names.value(gateway, :shadow_documents) do
      nil ->
        {:error, {:unavailable, "the shadow does not run"}}

      %{local?: true} = kept ->
        {:local, kept}

      kept ->
        with nil <- connection(gateway, kept),
             do: {:error, {:unavailable, "NATS is away, and desired states are kept there"}}
    end
  end

  defp connection(gateway, kept) do
    with conn when is_pid(conn) <- Bridge.connection(gateway), do: {:nats, conn, kept}
  end

  @doc "The connection and the environment, for reading other gateways' reports; nil without NATS."
  @spec nats(Names.gateway()) :: {pid(), environment :: String.t()} | nil
  def nats(gateway) do
    with {:nats, conn, kept} <- place(gateway), do: {conn, kept.environment}, else: (_none -> nil)
  end

  @doc "The shadow's folder; nil while the shadow does not run."
  @spec dir(Names.gateway()) :: Path.t() | nil
  def dir(gateway), do: with(%{dir: dir} <- Names.value(gateway, :shadow_documents), do: dir)

  defp row(gateway, key) do
    with_table(gateway, nil, &:ets.lookup_element(&1, key, 2, nil))
  end

  defp with_table(gateway, absent, read),
    do: Names.read(gateway, :shadow_documents, absent, fn %{table: table} -> read.(table) end)
end
