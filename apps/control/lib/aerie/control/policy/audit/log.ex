defmodule Aerie.Control.Policy.Audit.Log do
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

  alias Aerie.Base.Files.{Disk, Private, Raw}
  alias Aerie.Base.Segments
  alias Aerie.Control.Policy.Audit.{Chain, Record}
  alias Aerie.Base.Segments.Segment

  @enforce_keys [:store, :max_bytes, :segment_bytes]
  defstruct [:store, :max_bytes, :segment_bytes, n: 0, hash: nil]

  @opaque t :: %__MODULE__{}
  @format 1

  @doc "Opens the log of a folder, for its owner alone; `max_bytes` is the most that it may take on the disk."
  @spec open(Path.t(), pos_integer(), now :: integer()) :: {:ok, t()} | {:error, String.t()}
  def open(dir, max_bytes, now) do
    with :ok <- Private.folder(dir),
         {:ok, store} <- Chain.files(dir),
         segment_bytes = max(div(max_bytes, 8), Record.max_bytes()),
         log = %__MODULE__{store: store, max_bytes: max_bytes, segment_bytes: segment_bytes},
         {:ok, log, found} <- load(log),
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
  def bytes(log), do: Segments.bytes(log.store)

  @doc "Writes an entry. A write that fails half way (a full disk) is taken back, and the log is as it was."
  @spec append(t(), %{String.t() => term()}, now :: integer()) :: {:ok, t()} | {:error, String.t(), t()}
  def append(log, entry, now) do
    with {:ok, log} <- rotate(log, now),
         {:ok, log} <- write(log, entry, now) do
      {:ok, log}
    else
      {:error, reason, log} -> {:error, text(log.store.dir, reason), log}
    end
  end

  @doc "Brings what was written to the disk. Any process may call it, one at a time."
  @spec sync(t(), (Path.t() -> :ok | {:error, File.posix()})) :: :ok | {:error, String.t()}
  def sync(log, sync \\ &Disk.sync/1) do
    with :ok <- sync.(Segments.last(log.store).path),
         :ok <- Private.write(head_file(log.store.dir), "#{log.n} #{log.hash}\n") do
      :ok
    else
      {:error, reason} -> {:error, text(log.store.dir, reason)}
    end
  end

  @doc "Closes the log, with everything on the disk if the disk allows it."
  @spec close(t()) :: :ok
  def close(log) do
    _ = sync(log)
    _ = Segments.close(log.store)
    :ok
  end

  @doc "The number and the hash that were safe last; nil when the folder has no head."
  @spec safe(Path.t()) :: {pos_integer(), String.t()} | nil
  def safe(dir) do
    with {:ok, text} <- Raw.read(head_file(dir)),
         [_, n, hash] <- Regex.run(~r/\A(\d{1,16}) ([0-9a-f]{64})\n\z/, text) do
      {String.to_integer(n), hash}
    else
      _none -> nil
    end
  end

  defp head_file(dir), do: Path.join(dir, "head")

  defp load(%{store: %{segments: []}} = log), do: begin(%{log | hash: Record.start()}, 1, [])

  defp load(log) do
    with {:ok, segment, {n, hash}, ending, nil} <- log.store |> Segments.last() |> Chain.read() do
      store = Segments.put_last(log.store, segment)
      log = %{log | store: store, n: n || segment.first - 1, hash: hash || Record.start()}

      case ending do
        # Behind all that may have had a number.
        {:damaged, line, lines} ->
          damaged = %{"type" => "damaged", "file" => Path.basename(segment.path), "line" => line}
          begin(%{log | n: log.n + lines}, log.n + lines + 1, [damaged])

        # Begun and never written to: the one before it is the last.
        _other when n == nil ->
          with {:ok, store} <- Segments.drop(store, segment),
               {:ok, log, found} <- load(%{log | store: store}),
               do: {:ok, log, found ++ repaired(ending)}

        # The torn end is cut off when the file is written; the record that is appended next has it.
        _other ->
          {:ok, log, repaired(ending)}
      end
    end
  end

  defp repaired(:whole), do: []

  defp repaired({:torn, bytes}) do
    torn = bytes |> String.slice(0, 8192) |> Base.encode64()
    [%{"type" => "repaired", "bytes" => byte_size(bytes), "torn" => torn}]
  end

  defp begin(log, first, found) do
    with {:ok, store} <- Segments.begin(log.store, first), do: {:ok, %{log | store: store}, found}
  end

  # A damaged end has hashes of its own.
  defp missing(log, found) do
    damaged? = Enum.any?(found, &(&1["type"] == "damaged"))

    case safe(log.store.dir) do
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

    case Segments.append(log.store, line) do
      {:ok, store} -> {:ok, %{log | store: store, n: log.n + 1, hash: hash}}
      {:error, reason, store} -> {:error, reason, %{log | store: store}}
    end
  end

  defp rotate(%{store: store, segment_bytes: most} = log, now) do
    with %Segment{bytes: bytes} when bytes >= most <- Segments.last(store),
         :ok <- Segments.sync(store),
         {:ok, log, []} <- begin(log, log.n + 1, []) do
      prune(log, now)
    else
      %Segment{} -> {:ok, log}
      {:error, reason} -> {:error, reason, log}
    end
  end

  # The record about it is written first, so that a kill in between leaves a log that explains itself.
  defp prune(%{store: %{segments: [oldest, second | _rest]}} = log, now) do
    with true <- Segments.bytes(log.store) > log.max_bytes - log.segment_bytes,
         {:ok, _segment, {n, hash}, _ending, nil} <- Chain.read(oldest),
         pruned = %{"type" => "pruned", "n_before" => n || second.first - 1, "hash_before" => hash},
         {:ok, log} <- write(log, pruned, now) do
      case Segments.drop(log.store, oldest) do
        {:ok, store} -> prune(%{log | store: store}, now)
        {:error, reason} -> {:error, reason, log}
      end
    else
      false -> {:ok, log}
      {:error, reason} -> {:error, reason, log}
      error -> error
    end
  end

  defp prune(log, _now), do: {:ok, log}

  defp text(dir, reason), do: "#{dir}: #{:file.format_error(reason)}"
end
