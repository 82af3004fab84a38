defmodule Aerie.Recorder.Recording do
  @moduledoc """
  The process that writes the frames of one link or vehicle, or saves a ring. Nobody waits for it: frames come over a
  bounded queue (`Aerie.Recorder.Tap`), and what it cannot write it drops and counts.

  Records are collected for half a second or 64 KiB and written at once, whole; so after `kill -9`, or when the disk is
  full, at most the last record is cut off, and everything before it can be read. A fault of the disk (full, read-only, gone,
  less free than `min_free`) ends the file; it is tried again after `pause_ms`, in a new file.

  It registers as `{gateway, :recording, target}`. A link's belongs to the link's tree, a vehicle's and a ring's to
  `Aerie.Recorder.Supervisor`.
  """
  use GenServer

  alias Aerie.Link.Successor
  alias Aerie.Names
  alias Aerie.Recorder.{Archive, Core, Ring, Tables, Tap}
  alias MavCodec.Tlog

  @buffer 65_536
  @second_ms 1_000
  # What is recorded up to a time ends by the clock too, if nothing more comes.
  @grace_ms 2_000
  @remembered 256

  @typedoc """
  - `state`: `:off`, `:waiting` (for arming, or for a first frame), `:recording`, `:paused` (`reason` says why)
  - `file`, `since` (unix seconds): what is being written
  - `frames`, `bytes`, `files`: written; `dropped`: frames that were to be written and were not
  """
  @type status :: %{
          target: Tables.target(),
          label: String.t(),
          mode: Core.mode(),
          state: :off | :waiting | :recording | :paused,
          reason: String.t() | nil,
          file: Path.t() | nil,
          since: integer | nil,
          frames: non_neg_integer,
          bytes: non_neg_integer,
          files: non_neg_integer,
          dropped: non_neg_integer
        }

  @doc """
  Options: `:gateway`, `:target`, `:label`; for a ring that is saved `:until` (unix microseconds of frames) and `:notify` (an
  alias that gets `{alias, {:ok, file} | {:error, text}}` when what there was is written).
  """
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :recording, Keyword.fetch!(options, :target))
    start = fn -> GenServer.start_link(__MODULE__, options, name: name) end

    # A link's tree that was killed may be started again before its processes know. Of the others there is one at a time.
    if match?({:link, _id}, options[:target]), do: Successor.start(start), else: start.()
  end

  @doc false
  def child_spec(options) do
    target = Keyword.fetch!(options, :target)
    restart = if match?({:link, _id}, target), do: :permanent, else: :temporary
    %{id: {__MODULE__, target}, start: {__MODULE__, :start_link, [options]}, restart: restart}
  end

  @doc "Says that the mode of a target was changed in the tables."
  @spec changed(pid) :: :ok
  def changed(pid), do: GenServer.call(pid, :changed)

  @doc "Records up to a later time (unix microseconds of frames)."
  @spec extend(pid, integer) :: :ok
  def extend(pid, until), do: GenServer.cast(pid, {:extend, until})

  @doc "Writes what was collected; gives the file, nil when there is none."
  @spec flush(pid) :: Path.t() | nil
  def flush(pid), do: GenServer.call(pid, :flush)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)

    case Tables.of(gateway) do
      nil -> :ignore
      tables -> begin(gateway, tables, options)
    end
  end

  defp begin(gateway, tables, options) do
    Process.flag(:trap_exit, true)
    target = Keyword.fetch!(options, :target)
    Process.set_label({:recording, target})
    settings = Tables.settings(tables)

    state = %{
      gateway: gateway,
      tables: tables,
      settings: settings,
      files: settings.files,
      target: target,
      label: Keyword.fetch!(options, :label),
      core: Core.new(:off, settings.after_ms * 1000),
      tap: nil,
      counted: 0,
      device: nil,
      file: nil,
      since: nil,
      size: 0,
      opened: nil,
      buffer: [],
      buffered: 0,
      waiting: 0,
      flush: nil,
      synced: true,
      paused_until: nil,
      totals: former(tables, target),
      reason: nil,
      # Of a ring that is saved: the numbers of the entries that were in it, and when it is over.
      taken: MapSet.new(),
      first: 0,
      over_at: nil
    }

    Process.send_after(self(), :second, @second_ms)

    # Whoever begins one finds it listening.
    case Keyword.fetch(options, :until) do
      {:ok, until} ->
        {:ok, listen(%{state | core: Core.new({:until, until}, 0)}), {:continue, {:save, options[:notify]}}}

      :error ->
        {:ok, state |> adopt_mode() |> publish()}
    end
  end

  defp former(tables, target) do
    case :ets.lookup(tables.status, target) do
      [{_target, status}] -> Map.take(status, [:frames, :bytes, :files, :dropped])
      [] -> %{frames: 0, bytes: 0, files: 0, dropped: 0}
    end
  end

  @impl GenServer
  def handle_continue({:save, notify}, state), do: {:noreply, save(state, notify)}

  # What the ring has, then what comes: listened for already, so that nothing is missing between the two; what is in both
  # is told by its number.
  defp save(%{target: {:saved, key}} = state, notify) do
    entries = Ring.entries(state.tables, key)
    taken = entries |> Enum.take(-@remembered) |> MapSet.new(&elem(&1, 0))
    state = %{state | core: %{state.core | on: true}, taken: taken, first: Enum.min(taken, fn -> 0 end)}

    state =
      Enum.reduce(entries, state, fn {_n, records, frames}, state ->
        collect(state, records, byte_size(records), frames)
      end)

    state = ends_by(flush_now(state))
    result = if state.file, do: {:ok, state.file}, else: {:error, state.reason || "there is nothing to save"}
    if notify, do: send(notify, {notify, result})
    publish(state)
  end

  defp ends_by(state) do
    wait = state.settings.after_ms + @grace_ms
    Process.send_after(self(), :over, wait)
    %{state | over_at: now() + wait}
  end

  @impl GenServer
  def handle_call(:changed, _from, state), do: {:reply, :ok, state |> adopt_mode() |> publish()}

  def handle_call(:flush, _from, state) do
    state = state |> flush_now() |> publish()
    {:reply, state.file, state}
  end

  @impl GenServer
  def handle_cast({:extend, until}, state) do
    {:until, former} = state.core.mode
    {:noreply, ends_by(%{state | core: %{state.core | mode: {:until, max(until, former)}}})}
  end

  @impl GenServer
  def handle_info({:record, size, _frames, n}, %{first: first} = state) when is_integer(n) and n < first,
    do: {:noreply, done(state, size)}

  def handle_info({:record, size, frames, n}, state) do
    frames = if MapSet.member?(state.taken, n), do: [], else: frames
    {core, parts} = Core.frames(state.core, frames)
    state = Enum.reduce(parts, %{state | core: core}, &part/2)
    # Not before it is written, or dropped: what waits in the buffer still takes memory.
    state = if state.buffered == 0, do: done(state, size), else: %{state | waiting: state.waiting + size}
    if over?(state), do: {:stop, :normal, finish(state)}, else: {:noreply, state}
  end

  def handle_info(:flush, state), do: {:noreply, flush_now(%{state | flush: nil})}

  def handle_info(:second, state) do
    Process.send_after(self(), :second, @second_ms)
    {:noreply, state |> sync_due() |> rotate_due() |> publish()}
  end

  def handle_info(:over, state) do
    if now() >= state.over_at, do: {:stop, :normal, finish(state)}, else: {:noreply, state}
  end

  def handle_info(_late, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: finish(state)

  defp finish(state), do: state |> flush_now() |> close_file() |> deaf() |> publish()
  defp over?(%{core: %{mode: {:until, _at}, on: on}}), do: not on
  defp over?(_state), do: false

  ## What is recorded

  defp adopt_mode(state) do
    mode = Tables.mode(state.tables, state.target)
    {core, parts} = if mode == :off, do: Core.stop(state.core), else: {state.core, []}
    state = Enum.reduce(parts, %{state | core: Core.mode(core, mode)}, &part/2)
    if mode == :off, do: deaf(state), else: listen(state)
  end

  # A former life may have been killed.
  defp listen(%{tap: nil} = state) do
    Tap.sweep(state.tables)
    %{state | tap: Tap.open(state.tables, tap_of(state.target), state.settings.queue), counted: 0}
  end

  defp listen(state), do: state

  defp deaf(%{tap: nil} = state), do: state

  defp deaf(state) do
    Tap.close(state.tables, tap_of(state.target))
    %{drops(state) | tap: nil}
  end

  # A ring that is saved goes on with what its vehicle sends.
  defp tap_of({:saved, key}), do: {:vehicle, key}
  defp tap_of(target), do: target

  defp part(:close, state), do: state |> flush_now() |> close_file()

  defp part(frames, state) do
    records = Tlog.Writer.records(frames, signatures: false)
    collect(state, records, IO.iodata_length(records), length(frames))
  end

  ## The buffer

  defp collect(state, _records, 0, _frames), do: state

  defp collect(%{paused_until: until} = state, records, size, frames) when until != nil do
    if now() >= until,
      do: collect(%{state | paused_until: nil}, records, size, frames),
      else: dropped(state, frames)
  end

  defp collect(state, records, size, frames) do
    # Copied, so that nothing of the link's reads stays in memory for it.
    entry = {IO.iodata_to_binary(records), frames}
    state = %{state | buffer: [entry | state.buffer], buffered: state.buffered + size}
    if state.buffered >= @buffer, do: flush_now(state), else: flush_later(state)
  end

  defp flush_later(%{flush: nil} = state),
    do: %{state | flush: Process.send_after(self(), :flush, state.settings.flush_ms)}

  defp flush_later(state), do: state

  defp flush_now(%{buffer: []} = state), do: state

  defp flush_now(state) do
    state = drop_timer(state)
    frames = Enum.reduce(state.buffer, 0, fn {_bytes, n}, sum -> sum + n end)
    bytes = state.buffer |> Enum.reverse() |> Enum.map(&elem(&1, 0))

    state
    |> open_file()
    |> write(bytes, frames)
    |> Map.merge(%{buffer: [], buffered: 0})
    |> answered()
    |> sync_now(:always)
  end

  defp drop_timer(%{flush: nil} = state), do: state

  defp drop_timer(state) do
    _ = Process.cancel_timer(state.flush)
    %{state | flush: nil}
  end

  defp answered(state), do: done(%{state | waiting: 0}, state.waiting)

  defp done(%{tap: nil} = state, _size), do: state

  defp done(state, size) do
    Tap.done(state.tap, size)
    state
  end

  ## The file

  defp open_file(state) do
    cond do
      low?(state) -> state |> close_file() |> pause("less than #{mega(state.settings.min_free)} MB are free")
      state.device != nil and state.size >= state.settings.max_file -> state |> close_file() |> new_file()
      state.device != nil -> state
      true -> new_file(state)
    end
  end

  defp low?(state), do: match?([{:space, %{low: true}}], :ets.lookup(state.tables.settings, :space))

  defp new_file(state) do
    with {:ok, path} <- Archive.new_file(state.gateway, state.label),
         false <- low?(state) && :low,
         {:ok, device} <- state.files.open(path) do
      state = %{
        state
        | device: device,
          file: path,
          size: 0,
          since: System.os_time(:second),
          opened: now(),
          reason: nil
      }

      tell(state, :opened, %{count: 1}, %{})
      count(state, :files, 1)
    else
      :low -> pause(state, "less than #{mega(state.settings.min_free)} MB are free")
      {:error, reason} -> pause(state, words(reason))
    end
  end

  defp write(%{device: nil} = state, _bytes, frames), do: dropped(state, frames)

  defp write(state, bytes, frames) do
    size = IO.iodata_length(bytes)

    case state.files.write(state.device, bytes) do
      :ok ->
        %{state | size: state.size + size, synced: false} |> count(:frames, frames) |> count(:bytes, size)

      {:error, reason} ->
        state |> dropped(frames) |> close_file() |> pause(words(reason))
    end
  end

  defp close_file(%{device: nil} = state), do: state

  defp close_file(state) do
    if state.settings.fsync != :never, do: state.files.sync(state.device)
    _ = state.files.close(state.device)
    Archive.closed(state.gateway, state.file)
    tell(state, :closed, %{bytes: state.size}, %{})
    %{state | device: nil, file: nil, since: nil, synced: true}
  end

  defp pause(%{paused_until: nil} = state, reason) do
    Archive.look(state.gateway)
    tell(state, :paused, %{count: 1}, %{reason: reason})
    %{state | paused_until: now() + state.settings.pause_ms, reason: reason}
  end

  defp pause(state, _reason), do: state

  defp sync_due(%{settings: %{fsync: :interval}} = state), do: sync_now(state, :interval)
  defp sync_due(state), do: state

  defp sync_now(%{device: device, synced: false, settings: %{fsync: policy}} = state, policy)
       when device != nil do
    case state.files.sync(device) do
      :ok -> %{state | synced: true}
      {:error, reason} -> state |> close_file() |> pause(words(reason))
    end
  end

  defp sync_now(state, _policy), do: state

  defp rotate_due(%{device: device} = state) when device != nil do
    if now() - state.opened >= state.settings.max_file_ms,
      do: state |> flush_now() |> close_file(),
      else: state
  end

  defp rotate_due(state), do: state

  ## What is told

  defp dropped(state, frames), do: count(state, :dropped, frames)
  defp count(state, what, n), do: %{state | totals: Map.update!(state.totals, what, &(&1 + n))}

  defp drops(%{tap: nil} = state), do: state

  defp drops(state) do
    dropped = Tap.dropped(state.tap)
    count(%{state | counted: dropped}, :dropped, dropped - state.counted)
  end

  defp publish(state) do
    state = drops(state)
    :ets.insert(state.tables.status, {state.target, status(state)})
    state
  end

  defp status(state) do
    Map.merge(state.totals, %{
      target: state.target,
      label: state.label,
      mode: state.core.mode,
      state: state_of(state),
      reason: state.reason,
      file: state.file,
      since: state.since
    })
  end

  defp state_of(%{core: %{mode: :off}}), do: :off
  defp state_of(%{device: device}) when device != nil, do: :recording
  defp state_of(%{paused_until: until}) when until != nil, do: :paused
  defp state_of(_state), do: :waiting

  defp tell(state, event, measurements, metadata) do
    metadata = Map.merge(%{gateway: state.gateway, target: state.target, file: state.file}, metadata)
    :telemetry.execute([:aerie, :recorder, event], measurements, metadata)
  end

  defp words(text) when is_binary(text), do: text
  defp words(reason) when is_atom(reason), do: reason |> :file.format_error() |> to_string()
  defp words(reason), do: inspect(reason)

  defp mega(bytes), do: div(bytes, 1024 * 1024)
  defp now, do: System.monotonic_time(:millisecond)
end
