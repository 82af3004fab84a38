defmodule Aerie.Fleet.Bridge.Events.Stores do
  @moduledoc """
  The two stores from which `Aerie.Fleet.Bridge.Events` takes its events: the outbox on disk first, then the journal. It
  opens the outbox, moves events from the journal into it, syncs it to the disk, and puts events into the window, with a
  marker where a bounded store dropped some.

  It works on that process's state: `gateway`, `environment`, `epoch`, `settings` (the configuration's `outbox`),
  `outbox` (nil while it cannot be used), `problem` (its fault, logged once), `synced_at`, `window`, `gaps`, and
  `places`, each event's place in its vehicle's order.
  """

  alias Aerie.Base.Files.FolderLock
  alias Aerie.Fleet.Bridge.Events.{Gaps, Outbox, Window}
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Vehicle.Events.Journal

  require Logger

  @batch 500

  @doc "Opens the outbox. While that fails, events stay in the journal."
  @spec open(map()) :: map()
  def open(%{settings: settings} = state) do
    sizes = [max_bytes: settings.max_mb * 1_048_576, segment_bytes: settings.segment_kb * 1024]
    options = [gateway: state.gateway] ++ sizes

    with :ok <- FolderLock.acquire(settings.dir), {:ok, outbox} <- Outbox.open(settings.dir, options) do
      %{state | outbox: outbox, problem: nil}
    else
      {:error, reason} when is_binary(reason) -> problem(state, reason)
      {:error, reason} -> problem(state, :file.format_error(reason))
    end
  end

  @doc "Moves all pending events from the journal to the outbox. An event leaves the journal once the outbox has it."
  @spec spill(map()) :: map()
  def spill(%{outbox: nil} = state), do: state

  def spill(state) do
    case Journal.pending(state.gateway, @batch) do
      [] -> state
      events -> spill(state, events)
    end
  end

  defp spill(state, events) do
    case Outbox.append(state.outbox, Enum.map(events, &record(state, &1))) do
      {:ok, outbox} ->
        outbox = if state.settings.fsync == :always, do: Outbox.sync(outbox), else: outbox
        written(state, events)
        spill(%{state | outbox: outbox, problem: nil})

      {:error, reason, outbox, written} ->
        written(state, Enum.take(events, written))
        Tables.count(state.tables, :outbox_errors)
        problem(%{state | outbox: outbox}, :file.format_error(reason))
    end
  end

  defp written(_state, []), do: :ok

  defp written(state, events) do
    Journal.ack(state.gateway, Enum.map(events, & &1.id))
    Tables.count(state.tables, :outbox_written, [], length(events))
  end

  @doc "Syncs the outbox to the disk when that is due (`outbox.fsync: interval`)."
  @spec sync(map()) :: map()
  def sync(%{outbox: outbox, settings: %{fsync: :interval}} = state) when outbox != nil do
    now = System.monotonic_time(:millisecond)

    if now - state.synced_at >= state.settings.fsync_interval_ms,
      do: %{state | outbox: Outbox.sync(outbox), synced_at: now},
      else: state
  end

  def sync(state), do: state

  defp problem(state, reason) do
    text =
      "events cannot be kept on disk in #{state.settings.dir}: #{reason}; they stay in memory until NATS is back"

    if text != state.problem, do: Logger.error(text)
    %{state | problem: text}
  end

  @doc "Fills the window, up to twice what may be in flight."
  @spec fill(map()) :: map()
  def fill(state) do
    if Window.size(state.window) >= 2 * state.window.max, do: state, else: fill_from(source(state), state)
  end

  @doc "Whether an event waits in one of the stores."
  @spec waiting?(map()) :: boolean()
  def waiting?(state), do: journal?(state) or source(state) == :outbox

  @doc "Whether an event waits in the journal."
  @spec journal?(map()) :: boolean()
  def journal?(state), do: Journal.pending_size(state.gateway) > 0

  defp source(%{outbox: nil}), do: :journal
  defp source(%{outbox: outbox}), do: if(Outbox.empty?(outbox), do: :journal, else: :outbox)

  defp fill_from(:outbox, state) do
    {records, outbox} = Outbox.read(state.outbox, 2 * state.window.max)

    Enum.reduce(records, %{state | outbox: outbox}, fn {seq, record}, state ->
      put(state, {:outbox, seq}, record, Gaps.place(decoded(record.body)))
    end)
  end

  defp fill_from(:journal, state) do
    for event <- Journal.pending(state.gateway, 4 * state.window.max),
        key = {:journal, event.id},
        not Window.member?(state.window, key),
        reduce: state do
      state -> put(state, key, record(state, event), place(state.epoch, event))
    end
  end

  defp place(nil, _event), do: nil
  defp place(epoch, event), do: {event.vehicle, epoch, event.seq, event.seq}

  # A bounded store dropped what is missing before it: a reader gets a marker in its place.
  defp put(state, key, record, place) do
    {missing, gaps} = Gaps.observe(state.gaps, place, false)

    marker =
      if missing,
        do: [{{:lost, key}, Gaps.marker(state.environment, missing, System.os_time(:microsecond))}],
        else: []

    window = Window.put(state.window, marker ++ [{key, record}])
    %{state | gaps: gaps, places: Map.put(state.places, key, place), window: window}
  end

  defp decoded(body) do
    case JSON.decode(body) do
      {:ok, object} -> object
      {:error, _damaged} -> nil
    end
  end

  # An event as a record of the outbox.
  defp record(state, event) do
    subject = Message.event_subject(state.environment, event)

    %Outbox.Record{
      id: event.id,
      vehicle: event.vehicle,
      subject: subject,
      body: Message.event(event, state.epoch)
    }
  end
end
