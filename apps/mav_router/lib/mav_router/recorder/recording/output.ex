defmodule MavRouter.Recorder.Recording.Output do
  # The longest pause, in times of `pause_ms`.
  @longest 12
  # Less than callers wait for a recording (`Recording`), so that they learn what became of it.
  @slow_disk_ms 25_000
  @saving_ms 60_000

  @moduledoc """
  The files of a recording, one after the other, and what happens when the disk does not take the records.

  A file starts with the first records and is followed by the next one when it is long or old enough. A fault of the disk (full,
  read-only, gone, less than `min_free`) ends the file. Records that come then are dropped and counted, until a retry in a new file
  succeeds: after `pause_ms`, then twice that, up to #{@longest} times that. The log has each fault once for all recordings, until one of
  them writes again. A disk that does not answer is waited for: #{div(@slow_disk_ms, 1_000)} s, or #{div(@saving_ms, 1_000)} s when a ring is saved, for what came before
  a failsafe cannot be recorded again. A file grows by whole records only, except for the last one before a fault.

  An output belongs to the process that made it, as its files do.
  """

  require Logger

  alias Aerie.Base.Timing.Backoff
  alias Aerie.Base.Names
  alias Aerie.Base.Files.Raw
  alias MavRouter.Recorder.{Archive, Settings, Tables}

  @enforce_keys [:gateway, :target, :label, :settings, :tables]
  defstruct @enforce_keys ++
              [
                :device,
                :file,
                :since,
                :opened,
                :paused_until,
                :reason,
                :error,
                :logged,
                pauses: 0,
                size: 0,
                synced: true,
                totals: %{frames: 0, bytes: 0, files: 0, dropped: 0, errors: 0}
              ]

  @typedoc """
  - `file`, `size`, `since` (unix seconds), `opened` (monotonic ms): of the file that is being written
  - `paused_until` (monotonic ms), `reason`: while nothing is written
  - `error`: the last fault, `%{at: unix seconds, reason: text}`
  - `logged`: the fault that is in the log, until something is written again; `pauses`: the retries since
  - `totals`: frames and bytes written, files begun, frames `dropped`, `errors` of the disk
  """
  @type t :: %__MODULE__{}

  @doc "Nothing written yet; `former` has the totals and the last error of a former process."
  @spec new(Names.gateway(), Tables.t(), Tables.target(), String.t(), map | nil) :: t
  def new(gateway, tables, target, label, former) do
    output = %__MODULE__{
      gateway: gateway,
      tables: tables,
      target: target,
      label: label,
      settings: Tables.settings(tables)
    }

    case former do
      nil -> output
      former -> %{output | error: former.error, totals: Map.take(former, Map.keys(output.totals))}
    end
  end

  @doc "Whether records are dropped without a retry."
  @spec paused?(t) :: boolean
  def paused?(%{paused_until: nil}), do: false
  def paused?(%{paused_until: until}), do: now() < until

  @doc "Writes the records of some frames to the present file or a new one, or drops them."
  @spec write(t, iodata, pos_integer) :: t
  def write(output, records, frames) do
    if paused?(output) do
      dropped(output, frames)
    else
      %{output | paused_until: nil} |> ready() |> append(records, frames) |> sync_now(:always)
    end
  end

  @doc "Counts frames that could not be written."
  @spec dropped(t, non_neg_integer) :: t
  def dropped(output, frames), do: count(output, :dropped, frames)

  @doc "Completes the file."
  @spec close(t) :: t
  def close(%{device: nil} = output), do: output

  def close(%{settings: settings} = output) do
    if settings.fsync != :never, do: settings.files.sync(output.device)
    _ = settings.files.close(output.device)
    Archive.closed(output.gateway, output.file)
    emit(output, :closed, %{bytes: output.size}, %{})
    %{output | device: nil, file: nil, since: nil, size: 0, synced: true}
  end

  @doc "Once a second: forces new records to the disk, and checks whether the file is still there."
  @spec second(t) :: t
  def second(output), do: output |> sync_now(:interval) |> there()

  # The file or its disk was removed: records would be lost.
  defp there(%{file: file} = output) when file != nil do
    if Raw.exists?(file),
      do: output,
      else: output |> close() |> fault("#{file} was removed while it was written")
  end

  defp there(output), do: output

  @doc "Whether the file is old enough to be followed by the next."
  @spec old?(t) :: boolean
  def old?(%{device: nil}), do: false
  def old?(output), do: now() - output.opened >= output.settings.max_file_ms

  ## The file

  defp ready(%{settings: settings} = output) do
    cond do
      low?(output) -> output |> close() |> pause(low(settings))
      output.device != nil and output.size >= settings.max_file -> output |> close() |> open()
      output.device != nil -> output
      true -> open(output)
    end
  end

  defp open(%{settings: settings} = output) do
    with {:ok, path} <- Archive.new_file(output.gateway, output.label, wait_ms(output.target)),
         {:ok, device} <- settings.files.open(path) do
      output = %{output | device: device, file: path, size: 0, reason: nil}
      output = %{output | since: System.os_time(:second), opened: now()}
      emit(output, :opened, %{count: 1}, %{})
      count(output, :files, 1)
    else
      {:error, :low} -> pause(output, low(settings))
      {:error, reason} -> pause(output, reason_text(reason))
    end
  end

  defp wait_ms({:saved, _key}), do: @saving_ms
  defp wait_ms(_target), do: @slow_disk_ms

  defp append(%{device: nil} = output, _records, frames), do: dropped(output, frames)

  defp append(output, records, frames) do
    size = IO.iodata_length(records)

    case output.settings.files.write(output.device, records) do
      :ok ->
        %{well(output) | size: output.size + size, synced: false}
        |> count(:frames, frames)
        |> count(:bytes, size)

      {:error, reason} ->
        output |> dropped(frames) |> close() |> pause(reason_text(reason))
    end
  end

  defp sync_now(%{device: device, synced: false, settings: %{fsync: policy} = settings} = output, policy)
       when device != nil do
    case settings.files.sync(device) do
      :ok -> %{output | synced: true}
      {:error, reason} -> output |> close() |> pause(reason_text(reason))
    end
  end

  defp sync_now(output, _policy), do: output

  ## Faults

  defp low?(output), do: match?([{:space, %{low: true}}], :ets.lookup(output.tables.notes, :space))
  defp low(%Settings{min_free: min_free}), do: "less than #{div(min_free, 1024 * 1024)} MB are free"

  defp pause(output, reason) do
    Archive.check(output.gateway)
    emit(output, :paused, %{count: 1}, %{reason: reason})
    # Once, not for each retry of each recording.
    if reason != output.logged and :ets.insert_new(output.tables.notes, {{:logged, reason}, output.label}),
      do: Logger.warning("#{output.label} is not recorded: #{reason}")

    min = output.settings.pause_ms
    pauses = output.pauses + 1
    # The lower bounds of the back-off: without jitter.
    until = now() + Backoff.wait(pauses, min, 2 * min * @longest, 0.0)
    fault(%{output | paused_until: until, pauses: pauses, reason: reason, logged: reason}, reason)
  end

  defp well(%{logged: nil} = output), do: output

  defp well(output) do
    :ets.match_delete(output.tables.notes, {{:logged, :_}, :_})
    %{output | logged: nil, pauses: 0}
  end

  defp fault(output, reason),
    do: count(%{output | error: %{at: System.os_time(:second), reason: reason}}, :errors, 1)

  defp count(output, what, n), do: %{output | totals: Map.update!(output.totals, what, &(&1 + n))}

  defp emit(output, event, measurements, metadata) do
    metadata = Map.merge(%{gateway: output.gateway, target: output.target, file: output.file}, metadata)
    :telemetry.execute([:aerie, :recorder, event], measurements, metadata)
  end

  defp reason_text(text) when is_binary(text), do: text
  defp reason_text(reason) when is_atom(reason), do: reason |> :file.format_error() |> to_string()
  defp reason_text(reason), do: inspect(reason)

  defp now, do: System.monotonic_time(:millisecond)
end
