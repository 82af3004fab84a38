defmodule Aerie.Fleet.Bridge.Events.Disk do
  @moduledoc """
  The outbox of `Aerie.Fleet.Bridge.Events`: opens it, moves events from the journal into it, and syncs it to the disk.

  It works on that process's state: `gateway`, `environment`, `epoch`, `settings` (the configuration's `outbox`), `outbox`
  (nil while it cannot be used), `problem` (its fault, logged once) and `synced_at`.
  """

  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Vehicle.Journal
  alias Aerie.Base.Files.FolderLock

  alias Aerie.Vehicle.Event

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

  @doc "An event as a record of the outbox."
  @spec record(map(), Event.t()) :: Outbox.Record.t()
  def record(state, event) do
    subject = Message.event_subject(state.environment, event)

    %Outbox.Record{
      id: event.id,
      vehicle: event.vehicle,
      subject: subject,
      body: Message.event(event, state.epoch)
    }
  end

  defp problem(state, reason) do
    text =
      "events cannot be kept on disk in #{state.settings.dir}: #{reason}; they stay in memory until NATS is back"

    if text != state.problem, do: Logger.error(text)
    %{state | problem: text}
  end
end
