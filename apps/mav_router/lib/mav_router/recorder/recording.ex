defmodule MavRouter.Recorder.Recording do
  @moduledoc """
  The process that writes the frames of one link or vehicle, or saves a ring. Nobody waits for it: frames come through a bounded queue
  (`MavRouter.Recorder.Tap`), and those that it cannot write are dropped and counted.

  `MavRouter.Recorder.Core` decides which frames are recorded. Records are collected for half a second or 64 KiB, and whole records
  are written together (`Output`). So after `kill -9`, or when the disk is full, at most the last record of a file is cut off,
  and everything before it can be read.

  The recording of a vehicle that is always recorded begins with its ring, since the vehicle was heard before the recording started.

  It registers as `{gateway, :recording, target}`. A link's belongs to the link's tree, a vehicle's and a ring's to
  `MavRouter.Recorder.Supervisor`.
  """
  use GenServer

  alias Aerie.Base.Names
  alias MavRouter.Recorder.{Core, Ring, Status, Tables, Tap}
  alias MavRouter.Recorder.Recording.Output
  alias MavCodec.Tlog

  @second_ms 1_000
  # It may have to wait for a slow disk itself, at its end too.
  @call_ms 30_000
  # A recording up to a time ends by the clock too, if nothing more comes.
  @grace_ms 2_000
  # So many bytes are enough for one write.
  @full 65_536
  # Frames that come late are at most so many entries of the ring behind.
  @remembered 256
  # Records until they are written together. `waiting` are bytes that count as waiting in the queue until then:
  # collected records still take memory.
  @empty %{entries: [], bytes: 0, frames: 0, waiting: 0}

  @doc """
  Options: `:gateway`, `:target`, `:label`; for a ring that is saved `:until` (unix microseconds of frames) and `:notify` (an
  alias that gets `{alias, {:ok, file} | {:error, text}}` when what there was is written).
  """
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :recording, Keyword.fetch!(options, :target))
    GenServer.start_link(__MODULE__, options, name: name)
  end

  @doc false
  def child_spec(options) do
    target = Keyword.fetch!(options, :target)
    restart = if match?({:link, _id}, target), do: :permanent, else: :temporary
    start = {__MODULE__, :start_link, [options]}
    %{id: {__MODULE__, target}, start: start, restart: restart, shutdown: @call_ms}
  end

  @doc "The mode of the target was changed in the tables."
  @spec changed(pid) :: :ok
  def changed(pid), do: GenServer.call(pid, :changed, @call_ms)

  @doc "Records up to a later time (unix microseconds of frames)."
  @spec extend(pid, integer) :: :ok
  def extend(pid, until), do: GenServer.cast(pid, {:extend, until})

  @doc "Its vehicle is gone: the file is closed, and the recording ends."
  @spec leave(pid) :: :ok
  def leave(pid), do: GenServer.cast(pid, :leave)

  @doc "Writes the collected records; gives the file, nil when there is none."
  @spec flush(pid) :: Path.t() | nil
  def flush(pid), do: GenServer.call(pid, :flush, @call_ms)

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
    former = Status.of(tables, target)

    state = %{
      tables: tables,
      settings: settings,
      target: target,
      core: Core.new(:off, settings.after_ms * 1000),
      tap: nil,
      # How many of the frames that the queue dropped are in the output's total.
      counted: 0,
      buffer: @empty,
      flush: nil,
      # The entries of the ring with which the recording began: the first number that is remembered, and all of them.
      past: {0, MapSet.new()},
      output: Output.new(gateway, tables, target, Keyword.fetch!(options, :label), former),
      # When the saving of a ring ends if nothing more comes (monotonic ms).
      over_at: nil
    }

    Process.send_after(self(), :second, @second_ms)

    # It gets frames before this returns.
    case Keyword.fetch(options, :until) do
      {:ok, until} ->
        {:ok, open_tap(%{state | core: Core.new({:until, until}, 0)}), {:continue, {:save, options[:notify]}}}

      :error ->
        {:ok, state |> adopt_mode() |> publish(), {:continue, {:begin, former}}}
    end
  end

  @impl GenServer
  def handle_continue({:save, notify}, state) do
    state = %{state | core: %{state.core | on: true}} |> past() |> flush_now() |> ends_by()
    reason = state.output.reason || "there is nothing to save"
    result = if state.output.file, do: {:ok, state.output.file}, else: {:error, reason}
    if notify, do: send(notify, {notify, result})
    {:noreply, publish(state)}
  end

  # After a restart the frames of the ring are recorded already.
  def handle_continue({:begin, nil}, %{target: {:vehicle, _key}, core: %{mode: :always}} = state),
    do: {:noreply, past(%{state | core: %{state.core | on: true}})}

  def handle_continue({:begin, _former}, state), do: {:noreply, state}

  # The ring, then new frames, which come already: nothing is missing between the two. Frames that are in both have the
  # number of their entry (`MavRouter.Recorder.Ring.push/5`).
  defp past(%{target: {_kind, key}} = state) do
    entries = Ring.entries(state.tables, key)
    numbers = for {n, _records, _frames} <- Enum.take(entries, -@remembered), do: n
    state = %{state | past: {Enum.min(numbers, fn -> 0 end), MapSet.new(numbers)}}
    Enum.reduce(entries, state, fn {_n, records, frames}, state -> collect(state, records, frames) end)
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
    {:reply, state.output.file, state}
  end

  @impl GenServer
  def handle_cast({:extend, until}, state) do
    {:until, former} = state.core.mode
    {:noreply, ends_by(%{state | core: %{state.core | mode: {:until, max(until, former)}}})}
  end

  def handle_cast(:leave, state), do: {:stop, :normal, state}

  @impl GenServer
  def handle_info({:record, _target, size, frames, n}, state) do
    frames = if past?(state.past, n), do: [], else: frames
    {core, parts} = Core.frames(state.core, frames)
    state = Enum.reduce(parts, %{state | core: core}, &part/2)
    state = if state.buffer.entries == [], do: done(state, size), else: wait(state, size)
    if over?(state), do: {:stop, :normal, finish(state)}, else: {:noreply, state}
  end

  def handle_info(:flush, state), do: {:noreply, flush_now(%{state | flush: nil})}

  def handle_info(:second, state) do
    Process.send_after(self(), :second, @second_ms)
    state = %{state | output: Output.second(state.output)}
    state = if Output.old?(state.output), do: close(state), else: state
    {:noreply, publish(state)}
  end

  def handle_info(:over, state) do
    if now() >= state.over_at, do: {:stop, :normal, finish(state)}, else: {:noreply, state}
  end

  def handle_info(_late, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: finish(state)

  defp finish(state), do: state |> close() |> close_tap() |> publish()
  defp over?(%{core: %{mode: {:until, _at}, on: on}}), do: not on
  defp over?(_state), do: false

  # Frames without a number are in no ring.
  defp past?(_past, none) when none in [nil, :sent], do: false
  defp past?({first, numbers}, n), do: n < first or MapSet.member?(numbers, n)

  ## What is recorded

  defp adopt_mode(state) do
    mode = Tables.mode(state.tables, state.target)
    {core, parts} = if mode == :off, do: Core.stop(state.core), else: {state.core, []}
    state = Enum.reduce(parts, %{state | core: Core.mode(core, mode)}, &part/2)
    if mode == :off, do: close_tap(state), else: open_tap(state)
  end

  # A former process may have been killed.
  defp open_tap(%{tap: nil} = state) do
    Tap.sweep(state.tables)
    %{state | tap: Tap.open(state.tables, tap_of(state.target), state.settings.queue), counted: 0}
  end

  defp open_tap(state), do: state

  defp close_tap(%{tap: nil} = state), do: state

  defp close_tap(state) do
    Tap.close(state.tables, tap_of(state.target))
    %{drops(state) | tap: nil}
  end

  # After a ring come the frames of its vehicle.
  defp tap_of({:saved, key}), do: {:vehicle, key}
  defp tap_of(target), do: target

  defp part(:close, state), do: close(state)

  defp part(frames, state),
    do: collect(state, Tlog.records(frames, signatures: false), length(frames))

  ## From the queue to the file

  defp collect(state, _records, 0), do: state

  defp collect(state, records, frames) do
    if Output.paused?(state.output) do
      %{state | output: Output.dropped(state.output, frames)}
    else
      state = %{state | buffer: add(state.buffer, records, frames)}
      if state.buffer.bytes >= @full, do: flush_now(state), else: flush_later(state)
    end
  end

  # Copied, so that they do not keep a link's reads in memory.
  defp add(buffer, records, frames) do
    records = IO.iodata_to_binary(records)
    bytes = buffer.bytes + byte_size(records)
    %{buffer | entries: [records | buffer.entries], bytes: bytes, frames: buffer.frames + frames}
  end

  defp flush_later(%{flush: nil} = state),
    do: %{state | flush: Process.send_after(self(), :flush, state.settings.flush_ms)}

  defp flush_later(state), do: state

  defp flush_now(state) do
    if state.buffer.entries == [], do: state, else: write(drop_timer(state))
  end

  defp write(%{buffer: buffer} = state) do
    output = Output.write(state.output, Enum.reverse(buffer.entries), buffer.frames)
    done(%{state | output: output, buffer: @empty}, buffer.waiting)
  end

  defp drop_timer(%{flush: nil} = state), do: state

  defp drop_timer(state) do
    _ = Process.cancel_timer(state.flush)
    %{state | flush: nil}
  end

  defp close(state) do
    state = flush_now(state)
    %{state | output: Output.close(state.output)}
  end

  # Bytes leave the queue when they are written or dropped.
  defp wait(state, size), do: put_in(state.buffer.waiting, state.buffer.waiting + size)

  defp done(%{tap: nil} = state, _size), do: state

  defp done(state, size) do
    Tap.done(state.tap, size)
    state
  end

  ## Status

  defp drops(%{tap: nil} = state), do: state

  defp drops(state) do
    dropped = Tap.dropped(state.tap)
    %{state | counted: dropped, output: Output.dropped(state.output, dropped - state.counted)}
  end

  defp publish(state) do
    state = drops(state)
    Status.put(state.tables, state.target, Status.new(state.core.mode, state.output))
    state
  end

  defp now, do: System.monotonic_time(:millisecond)
end
