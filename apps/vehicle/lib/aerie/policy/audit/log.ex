defmodule Aerie.Policy.Audit.Log do
  @moduledoc """
  The audit log's folder as a value of the process that writes it: opened, repaired, appended to, bounded.

  A line is written at once, so that a kill of the program loses none, and brought to the disk (`sync/2`) a moment later. With
  it the file `head` is written: number and hash of the last record that is safe. A log that ends before its head was
  shortened.

  Records of the log's own, which have the `type`

    * `opened` - the log was opened; `format` is that of the lines
    * `repaired` - a line was torn by a kill or a power cut; `torn` has its bytes in base 64. Nothing is thrown away
    * `damaged` - from `line` of `file` on nothing fits; a new file was begun behind it
    * `missing` - the log ended before record `n` with `hash`, which had been safe
    * `pruned` - the oldest files, up to record `n` with `hash`, were removed for want of room
    * `missed` - so many `records` could not be written `since` then, for the `reason`
  """

  alias Aerie.{Disk, PrivateFile}
  alias Aerie.Policy.Audit.{Record, Segment}

  @enforce_keys [:dir, :max_bytes, :segment_bytes]
  defstruct [:dir, :max_bytes, :segment_bytes, :file, segments: [], bytes: 0, n: 0, hash: nil]

  @opaque t :: %__MODULE__{}
  @format 1

  @doc "Opens the log of a folder, for its owner alone; `max_bytes` is the most that it may take on the disk."
  @spec open(Path.t(), pos_integer(), now :: integer()) :: {:ok, t()} | {:error, String.t()}
  def open(dir, max_bytes, now) do
    log = %__MODULE__{
      dir: dir,
      max_bytes: max_bytes,
      segment_bytes: max(div(max_bytes, 8), Record.max_bytes())
    }

    with :ok <- PrivateFile.folder(dir),
         {:ok, segments} <- Segment.all(dir),
         {:ok, log, found} <- load(%{log | segments: segments}),
         entries = found ++ missing(log, found) ++ [%{"type" => "opened", "format" => @format}],
         {:ok, log} <- write_all(log, entries, now) do
      {:ok, log}
    else
      {:error, reason} -> {:error, text(dir, reason)}
      {:error, reason, _log} -> {:error, text(dir, reason)}
    end
  end

  @doc "Number and hash of the last record."
  @spec head(t()) :: {non_neg_integer(), String.t()}
  def head(log), do: {log.n, log.hash}

  @doc "The bytes that the log takes on the disk."
  @spec bytes(t()) :: non_neg_integer()
  def bytes(log), do: total(log)

  @doc "Writes an entry. A write that fails half way (a full disk) is taken back, and the log is as it was."
  @spec append(t(), %{String.t() => term()}, now :: integer()) :: {:ok, t()} | {:error, String.t(), t()}
  def append(log, entry, now) do
    with {:ok, log} <- rotate(log, now),
         {:ok, log} <- write(log, entry, now) do
      {:ok, log}
    else
      {:error, reason, log} -> {:error, text(log.dir, reason), log}
    end
  end

  @doc "Brings what was written to the disk. Any process may call it, one at a time."
  @spec sync(t(), (Path.t() -> :ok | {:error, File.posix()})) :: :ok | {:error, String.t()}
  def sync(log, sync \\ &Disk.sync/1) do
    with :ok <- sync.(Segment.path(log.dir, List.last(log.segments))),
         :ok <- PrivateFile.write(head_file(log.dir), "#{log.n} #{log.hash}\n") do
      :ok
    else
      {:error, reason} -> {:error, text(log.dir, reason)}
    end
  end

  @doc "Closes the log, with everything on the disk if the disk allows it."
  @spec close(t()) :: :ok
  def close(log) do
    _ = sync(log)
    _ = :file.close(log.file)
    :ok
  end

  @doc "The number and the hash that were safe last; nil when the folder has no head."
  @spec safe(Path.t()) :: {pos_integer(), String.t()} | nil
  def safe(dir) do
    with {:ok, text} <- File.read(head_file(dir)),
         [_, n, hash] <- Regex.run(~r/\A(\d{1,16}) ([0-9a-f]{64})\n\z/, text) do
      {String.to_integer(n), hash}
    else
      _none -> nil
    end
  end

  defp head_file(dir), do: Path.join(dir, "head")

  defp load(%{segments: []} = log) do
    with {:ok, log} <- begin(%{log | hash: Record.start()}, 1), do: {:ok, log, []}
  end

  defp load(log) do
    first = List.last(log.segments)
    path = Segment.path(log.dir, first)

    with {:ok, {last, good, ending}, _acc} <- Segment.read(path, {nil, nil}, nil, fn _record, acc -> acc end) do
      case {last, ending} do
        # Begun and never written to: the one before it is the last.
        {{nil, nil}, :whole} ->
          with :ok <- File.rm(path), do: load(%{log | segments: List.delete(log.segments, first)})

        {{nil, nil}, {:torn, bytes}} ->
          with :ok <- File.rm(path),
               {:ok, log, found} <- load(%{log | segments: List.delete(log.segments, first)}),
               do: {:ok, log, found ++ [repaired(bytes)]}

        {{n, hash}, :whole} ->
          with {:ok, log} <- reopen(%{log | n: n, hash: hash}, path, good), do: {:ok, log, []}

        {{n, hash}, {:torn, bytes}} ->
          with {:ok, log} <- reopen(%{log | n: n, hash: hash}, path, good), do: {:ok, log, [repaired(bytes)]}

        {{n, hash}, {:damaged, line, lines}} ->
          # Behind all that may have had a number.
          {n, hash} = {n || first - 1, hash || Record.start()}
          damaged = %{"type" => "damaged", "file" => Path.basename(path), "line" => line}

          with {:ok, log} <- begin(%{log | n: n + lines, hash: hash}, n + lines + 1),
               do: {:ok, log, [damaged]}
      end
    end
  end

  defp repaired(bytes),
    do: %{
      "type" => "repaired",
      "bytes" => byte_size(bytes),
      "torn" => bytes |> String.slice(0, 8192) |> Base.encode64()
    }

  # The torn end is cut off; the record that is appended next has it.
  defp reopen(log, path, good) do
    with {:ok, file} <- :file.open(path, [:read, :write, :raw, :binary]),
         {:ok, ^good} <- :file.position(file, good),
         :ok <- :file.truncate(file) do
      {:ok, %{log | file: file, bytes: good}}
    end
  end

  defp begin(log, first) do
    path = Segment.path(log.dir, first)

    with {:ok, file} <- :file.open(path, [:read, :write, :exclusive, :raw, :binary]),
         :ok <- File.chmod(path, 0o600) do
      {:ok, %{log | file: file, bytes: 0, segments: log.segments ++ [first]}}
    end
  end

  # A damaged end has hashes of its own.
  defp missing(log, found) do
    damaged? = Enum.any?(found, &(&1["type"] == "damaged"))

    case safe(log.dir) do
      {n, hash} when n > log.n or (n == log.n and hash != log.hash and not damaged?) ->
        [%{"type" => "missing", "n_before" => n, "hash_before" => hash}]

      _as_it_should_be ->
        []
    end
  end

  defp write_all(log, entries, now) do
    Enum.reduce_while(entries, {:ok, log}, fn entry, {:ok, log} ->
      case write(log, entry, now) do
        {:ok, log} -> {:cont, {:ok, log}}
        error -> {:halt, error}
      end
    end)
  end

  defp write(log, entry, now) do
    {line, hash} = Record.encode(entry, log.n + 1, log.hash, now)

    case :file.pwrite(log.file, log.bytes, line) do
      :ok ->
        {:ok, %{log | n: log.n + 1, hash: hash, bytes: log.bytes + byte_size(line)}}

      {:error, reason} ->
        # Where even that fails, the next line is written over it.
        _ = with {:ok, _position} <- :file.position(log.file, log.bytes), do: :file.truncate(log.file)
        {:error, reason, log}
    end
  end

  defp rotate(%{bytes: bytes, segment_bytes: most} = log, _now) when bytes < most, do: {:ok, log}

  defp rotate(log, now) do
    with :ok <- :file.datasync(log.file),
         old = log.file,
         {:ok, log} <- begin(log, log.n + 1) do
      _ = :file.close(old)
      prune(log, now)
    else
      {:error, reason} -> {:error, reason, log}
    end
  end

  # The record about it is written first, so that a kill in between leaves a log that explains itself.
  defp prune(log, now) do
    case log.segments do
      [oldest, second | _rest] when oldest != second ->
        if total(log) > log.max_bytes - log.segment_bytes,
          do: prune(log, oldest, second, now),
          else: {:ok, log}

      _one ->
        {:ok, log}
    end
  end

  defp prune(log, oldest, second, now) do
    path = Segment.path(log.dir, oldest)

    with {:ok, {{n, hash}, _good, _ending}, _acc} <-
           Segment.read(path, {nil, nil}, nil, fn _record, acc -> acc end),
         {:ok, log} <-
           write(log, %{"type" => "pruned", "n_before" => n || second - 1, "hash_before" => hash}, now),
         :ok <- File.rm(path) do
      prune(%{log | segments: List.delete(log.segments, oldest)}, now)
    else
      {:error, reason} -> {:error, reason, log}
      {:error, reason, log} -> {:error, reason, log}
    end
  end

  defp total(log) do
    for first <- Enum.drop(log.segments, -1),
        {:ok, stat} <- [File.stat(Segment.path(log.dir, first))],
        reduce: log.bytes,
        do: (bytes when is_integer(bytes) -> bytes + stat.size)
  end

  defp text(dir, reason), do: "#{dir}: #{:file.format_error(reason)}"
end
