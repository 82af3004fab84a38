defmodule MavRouter.Recorder.Archive do
  @moduledoc """
  The folder of the recordings: gives names, keeps the index of our files, makes room.

  Our files are those in `recordings.index`, one name a line, written before the file is used. No other file in the folder is ever
  removed, whatever its name; a recording that somebody renames or deletes from the index belongs to them from then on.

  Our oldest recordings are removed, but none that is being written, when all of them exceed `max_total` or less than `min_free` is free.
  If that does not help, nothing is recorded (`{:space, …}` in the settings' table) until there is room again. The folder is made when
  the first recording starts; it and its files are for their owner only. An empty file is removed when it is closed.
  """
  use GenServer

  alias Aerie.Base.Files.{Private, Raw}
  alias Aerie.Base.Names
  alias MavRouter.Recorder.{Archive, Tables}

  @index "recordings.index"
  @max_index 4_000_000
  @call_ms 10_000
  @block 4096

  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options,
      name: Names.via(Keyword.fetch!(options, :gateway), :recorder_archive)
    )
  end

  @doc """
  A new, empty file for the calling process, named `{label}-{UTC}.tlog`. It is not removed until `closed/2` or the end of the process.
  `:low`: less than `min_free` is free; any other error is a text. `wait_ms`: how long a slow disk is waited for.
  """
  @spec new_file(Names.gateway(), String.t(), pos_integer) :: {:ok, Path.t()} | {:error, String.t() | :low}
  def new_file(gateway, label, wait_ms) do
    GenServer.call(Names.via(gateway, :recorder_archive), {:new_file, label}, wait_ms)
  catch
    :exit, _reason -> {:error, "the folder of recordings does not answer"}
  end

  @doc "The file is complete. An empty one is removed."
  @spec closed(Names.gateway(), Path.t()) :: :ok
  def closed(gateway, path), do: GenServer.cast(Names.via(gateway, :recorder_archive), {:closed, path})

  @doc "Checks the free space and makes room; returns at once."
  @spec check(Names.gateway()) :: :ok
  def check(gateway), do: GenServer.cast(Names.via(gateway, :recorder_archive), :look)

  @doc "Our recordings, oldest first: `%{file, bytes, at (unix seconds of the last write), open}`."
  @spec list(Names.gateway()) :: [map]
  def list(gateway) do
    GenServer.call(Names.via(gateway, :recorder_archive), :list, @call_ms)
  catch
    :exit, _reason -> []
  end

  @doc "Removes one of our files by its name, unless it is being written."
  @spec delete(Names.gateway(), String.t()) :: :ok | {:error, :unknown | :open | String.t()}
  def delete(gateway, name) do
    GenServer.call(Names.via(gateway, :recorder_archive), {:delete, name}, @call_ms)
  catch
    :exit, _reason -> {:error, "the folder of recordings does not answer"}
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:recorder_archive, gateway})
    tables = Tables.of(gateway)
    settings = Tables.settings(tables)
    Process.send_after(self(), :space, settings.space_ms)

    {:ok, %{gateway: gateway, tables: tables, settings: settings, open: %{}}}
  end

  @impl GenServer
  def handle_call({:new_file, label}, {pid, _tag}, state) do
    with :ok <- Private.new_folder(state.settings.dir),
         _ = make_room(state),
         :ok <- room(state),
         {:ok, name} <- create(state, Archive.Name.new(label, System.os_time(:second)), 1) do
      path = Path.join(state.settings.dir, name)
      {:reply, {:ok, path}, put_in(state.open[Process.monitor(pid)], path)}
    else
      {:error, :low} -> {:reply, {:error, :low}, state}
      {:error, reason} -> {:reply, {:error, "#{state.settings.dir}: #{reason_text(reason)}"}, state}
    end
  end

  def handle_call(:list, _from, state) do
    open = Map.values(state.open)

    files =
      for name <- ours(state), path = Path.join(state.settings.dir, name), {:ok, stat} <- [stat(path)] do
        %{file: path, bytes: stat.size, at: stat.mtime, open: path in open}
      end

    {:reply, files, state}
  end

  def handle_call({:delete, name}, _from, state) do
    path = Path.join(state.settings.dir, name)

    cond do
      name not in ours(state) -> {:reply, {:error, :unknown}, state}
      path in Map.values(state.open) -> {:reply, {:error, :open}, state}
      true -> {:reply, removed(path), state}
    end
  end

  @impl GenServer
  def handle_cast({:closed, path}, state) do
    {closed, open} = Map.split_with(state.open, fn {_monitor, file} -> file == path end)
    Enum.each(Map.keys(closed), &Process.demonitor(&1, [:flush]))
    Enum.each(Map.values(closed), &without_empty/1)
    {:noreply, %{state | open: open}}
  end

  def handle_cast(:look, state), do: {:noreply, make_room(state)}

  @impl GenServer
  def handle_info({:DOWN, monitor, :process, _pid, _reason}, state) do
    {path, open} = Map.pop(state.open, monitor)
    _ = without_empty(path)
    {:noreply, %{state | open: open}}
  end

  def handle_info(:space, state) do
    Process.send_after(self(), :space, state.settings.space_ms)
    # Without an index nothing was ever recorded here.
    if Raw.exists?(index(state)), do: {:noreply, make_room(state)}, else: {:noreply, state}
  end

  # The index is corrected when room is made.
  defp removed(path) do
    with {:error, reason} <- Raw.rm(path), do: {:error, "#{path}: #{reason_text(reason)}"}
  end

  defp stat(path), do: Raw.stat(path)

  # No record was written to it. The index is corrected when room is made.
  defp without_empty(path), do: with({:ok, %{size: 0}} <- stat(path), do: Raw.rm(path))

  # Without a free block a file can be made, but not written.
  defp room(state) do
    case :ets.lookup(state.tables.notes, :space) do
      [{:space, %{low: true}}] -> {:error, :low}
      [{:space, %{free: free}}] when is_integer(free) and free < @block -> {:error, :enospc}
      _enough_or_unknown -> :ok
    end
  end

  # A file is in the index before it grows.
  defp create(_state, _name, attempt) when attempt > 100, do: {:error, :eexist}

  defp create(state, name, attempt) do
    file = Archive.Name.attempt(name, attempt)
    path = Path.join(state.settings.dir, file)

    with :ok <- state.settings.files.create(path),
         :ok <- noted(state, path, file) do
      {:ok, file}
    else
      {:error, :eexist} -> create(state, name, attempt + 1)
      error -> error
    end
  end

  defp noted(state, path, file) do
    with :ok <- Raw.append(index(state), file <> "\n"),
         :ok <- Raw.chmod(index(state), 0o600) do
      :ok
    else
      {:error, reason} ->
        # A file that is not in the index would never be removed.
        _ = Raw.rm(path)
        {:error, reason}
    end
  end

  defp index(state), do: Path.join(state.settings.dir, @index)

  # Only names of files beside the index: whatever somebody did to the index, no file elsewhere is ours.
  defp ours(state) do
    with {:ok, %{size: size}} when size <= @max_index <- stat(index(state)),
         {:ok, text} <- Raw.read(index(state)) do
      text |> String.split("\n", trim: true) |> Enum.filter(&Archive.Name.ours?/1) |> Enum.uniq()
    else
      _none -> []
    end
  end

  defp make_room(state) do
    %{dir: dir, max_total: max_total, min_free: min_free, files: files} = state.settings
    open = MapSet.new(Map.values(state.open))
    names = ours(state)

    found =
      for name <- names,
          path = Path.join(dir, name),
          {:ok, %{type: :regular, size: size}} <- [Raw.lstat(path)] do
        {path, size, path in open}
      end

    free = files.free(dir)
    total = found |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    removed = remove(found, total - max_total, missing(free, min_free), state.gateway)

    # An index that cannot be rewritten names files that are gone, which are skipped the next time.
    _ =
      if length(found) < length(names) or removed != [],
        do: rewrite(state, Enum.map(found, &elem(&1, 0)) -- removed)

    report(state, if(removed == [], do: free, else: files.free(dir)), min_free)
  end

  defp missing(:unknown, _min_free), do: 0
  defp missing({:ok, free}, min_free), do: min_free - free

  defp remove([], _too_many, _too_full, _gateway), do: []
  defp remove(_found, too_many, too_full, _gateway) when too_many <= 0 and too_full <= 0, do: []

  defp remove([{_path, _size, true} | rest], too_many, too_full, gateway),
    do: remove(rest, too_many, too_full, gateway)

  defp remove([{path, size, false} | rest], too_many, too_full, gateway) do
    case Raw.rm(path) do
      :ok ->
        :telemetry.execute([:aerie, :recorder, :removed], %{bytes: size}, %{gateway: gateway, file: path})
        [path | remove(rest, too_many - size, too_full - size, gateway)]

      {:error, _reason} ->
        remove(rest, too_many, too_full, gateway)
    end
  end

  defp rewrite(state, paths) do
    text = Enum.map(paths, &[Path.basename(&1), "\n"])
    Private.write(index(state), text)
  end

  defp report(state, free, min_free) do
    low = match?({:ok, bytes} when bytes < min_free, free)
    bytes = with {:ok, bytes} <- free, do: bytes
    :ets.insert(state.tables.notes, {:space, %{free: bytes, low: low}})
    state
  end

  defp reason_text(reason) when is_atom(reason), do: reason |> :file.format_error() |> to_string()
  defp reason_text(reason), do: inspect(reason)
end
