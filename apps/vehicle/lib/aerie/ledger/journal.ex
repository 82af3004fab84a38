defmodule Aerie.Ledger.Journal do
  @moduledoc """
  The ledger's file: a line with its format, then one record per line, preceded by its CRC-32.

      aerie-ledger 1
      8f2a90c1 ["new","a1","…",1795339800000000,{…}]

  An incomplete last line was never answered and is cut off. A line that is damaged in any other way is left out, and the
  damaged file is kept beside the new one. A file without such a beginning is not a ledger any more: whoever opens it sets it aside. The file is rewritten (`compact/2`) when most of it is out of date.
  """

  alias Aerie.{Disk, DiskFormat, PrivateFile}

  @format 1
  @head "aerie-ledger #{@format}\n"
  @max_line 65_536
  @max_bytes 1_073_741_824

  @enforce_keys [:path, :file, :bytes]
  defstruct @enforce_keys

  @type t :: %__MODULE__{path: Path.t(), file: :file.fd(), bytes: non_neg_integer()}

  @doc """
  Opens the file of a folder; `fun` gets each record. Returns how many damaged lines were left out. A file of a newer format is
  refused and left alone; `{:error, :damaged}` if the file is none of a ledger.
  """
  @spec open(Path.t(), acc, ([term()], acc -> acc)) ::
          {:ok, t(), acc, damaged :: non_neg_integer()} | {:error, String.t() | :damaged}
        when acc: term()
  def open(dir, acc, fun) do
    path = path(dir)

    with :ok <- PrivateFile.folder(dir),
         {:ok, good, acc, damaged} <- read(path, acc, fun),
         :ok <- keep(path, damaged),
         {:ok, journal} <- writer(path, good) do
      {:ok, journal, acc, damaged}
    else
      {:error, text} when is_binary(text) -> {:error, text}
      {:error, :damaged} -> {:error, :damaged}
      {:error, reason} -> {:error, text(path, reason)}
    end
  end

  @doc "The file of a folder."
  @spec path(Path.t()) :: Path.t()
  def path(dir), do: Path.join(dir, "ledger")

  @doc "Whether the file of a folder, if there is one, is of a format that this version reads."
  @spec check(Path.t()) :: :ok | {:error, String.t()}
  def check(dir) do
    path = path(dir)

    case File.open(path, [:read, :raw, :binary], &:file.read(&1, 64)) do
      {:ok, {:ok, bytes}} ->
        if other_format?(bytes |> String.split("\n", parts: 2) |> hd()),
          do: {:error, DiskFormat.newer(path, "ledger", "of another format", @format)},
          else: :ok

      # None, a torn one, or what reading it will say.
      _other ->
        :ok
    end
  end

  @doc "Writes records. A write that fails half way is undone."
  @spec append(t(), [[term()]]) :: {:ok, t()} | {:error, String.t(), t()}
  def append(journal, []), do: {:ok, journal}

  def append(journal, records) do
    lines = Enum.map(records, &line/1)

    case :file.pwrite(journal.file, journal.bytes, lines) do
      :ok ->
        {:ok, %{journal | bytes: journal.bytes + IO.iodata_length(lines)}}

      {:error, reason} ->
        _ =
          with {:ok, _position} <- :file.position(journal.file, journal.bytes),
               do: :file.truncate(journal.file)

        {:error, text(journal.path, reason), journal}
    end
  end

  @doc "Returns when everything written to the file would survive a power cut. Any process may call it."
  @spec sync(Path.t(), (Path.t() -> :ok | {:error, File.posix()})) :: :ok | {:error, String.t()}
  def sync(path, sync \\ &Disk.sync/1),
    do: with({:error, reason} <- sync.(path), do: {:error, text(path, reason)})

  @doc "Replaces the file with one that has these records."
  @spec compact(t(), Enumerable.t([term()])) :: {:ok, t()} | {:error, String.t(), t()}
  def compact(journal, records) do
    new = journal.path <> ".new"
    _ = File.rm(new)

    with {:ok, file} <- :file.open(new, [:read, :write, :exclusive, :raw, :binary]),
         :ok <- File.chmod(new, 0o600),
         {:ok, bytes} <- fill(file, records),
         :ok <- :file.datasync(file),
         :ok <- File.rename(new, journal.path) do
      _ = :file.close(journal.file)
      {:ok, %{journal | file: file, bytes: bytes}}
    else
      {:error, reason} ->
        _ = File.rm(new)
        {:error, text(new, reason), journal}
    end
  end

  @spec close(t()) :: :ok
  def close(journal) do
    _ = :file.datasync(journal.file)
    _ = :file.close(journal.file)
    :ok
  end

  defp fill(file, records) do
    records
    |> Stream.map(&line/1)
    |> Stream.chunk_every(500)
    |> Enum.reduce_while({:file.write(file, @head), byte_size(@head)}, fn lines, {:ok, bytes} ->
      case :file.write(file, lines) do
        :ok -> {:cont, {:ok, bytes + IO.iodata_length(lines)}}
        error -> {:halt, {error, bytes}}
      end
    end)
    |> case do
      {:ok, bytes} -> {:ok, bytes}
      {error, _bytes} -> error
    end
  end

  defp line(record) do
    json = JSON.encode!(record)
    [crc(json), " ", json, "\n"]
  end

  defp crc(json),
    do: json |> :erlang.crc32() |> Integer.to_string(16) |> String.pad_leading(8, "0") |> String.downcase()

  defp read(path, acc, fun) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, file} <- :file.open(path, [:read, :raw, :binary, {:read_ahead, 65_536}]) do
      result = file |> :file.read_line() |> head(path, file, acc, fun)
      _ = :file.close(file)
      result
    else
      {:error, :enoent} -> {:ok, 0, acc, 0}
      {:ok, _too_large} -> {:error, :efbig}
      error -> error
    end
  end

  defp head({:ok, @head}, _path, file, acc, fun), do: lines(file, byte_size(@head), acc, 0, fun)
  defp head(:eof, _path, _file, acc, _fun), do: {:ok, 0, acc, 0}

  # The file was torn when it was created, so nothing can follow.
  defp head({:ok, text}, _path, _file, acc, _fun)
       when binary_part(@head, 0, byte_size(text)) == text and byte_size(text) < byte_size(@head),
       do: {:ok, 0, acc, 0}

  defp head({:ok, other}, path, _file, _acc, _fun) do
    if other_format?(String.trim_trailing(other, "\n")),
      do: {:error, DiskFormat.newer(path, "ledger", "of another format", @format)},
      else: {:error, :damaged}
  end

  defp head({:error, reason}, _path, _file, _acc, _fun), do: {:error, reason}

  # A whole number, and not this one: not damage.
  defp other_format?("aerie-ledger " <> version), do: match?({n, ""} when n > @format, Integer.parse(version))
  defp other_format?(_other), do: false

  defp lines(file, good, acc, damaged, fun) do
    case :file.read_line(file) do
      :eof ->
        {:ok, good, acc, damaged}

      {:error, reason} ->
        {:error, reason}

      {:ok, line} ->
        case record(line) do
          {:ok, record} -> lines(file, good + byte_size(line), fun.(record, acc), damaged, fun)
          :torn -> {:ok, good, acc, damaged}
          :damaged -> lines(file, good + byte_size(line), acc, damaged + 1, fun)
        end
    end
  end

  defp record(line) do
    with true <- String.ends_with?(line, "\n") or :torn,
         true <- byte_size(line) <= @max_line,
         <<crc::binary-size(8), " ", json::binary>> <- String.trim_trailing(line, "\n"),
         ^crc <- crc(json),
         {:ok, [_ | _] = record} <- JSON.decode(json) do
      {:ok, record}
    else
      :torn -> :torn
      _other -> :damaged
    end
  end

  defp keep(_path, 0), do: :ok

  # One copy is enough: the first damage is the one to examine.
  defp keep(path, _damaged) do
    with {:ok, _bytes} <- File.copy(path, path <> ".damaged"), do: File.chmod(path <> ".damaged", 0o600)
  end

  defp writer(path, good) do
    with {:ok, file} <- :file.open(path, [:read, :write, :raw, :binary]),
         :ok <- File.chmod(path, 0o600),
         {:ok, ^good} <- :file.position(file, good),
         :ok <- :file.truncate(file),
         :ok <- if(good == 0, do: :file.write(file, @head), else: :ok) do
      {:ok, %__MODULE__{path: path, file: file, bytes: max(good, byte_size(@head))}}
    end
  end

  defp text(path, reason), do: "#{path}: #{:file.format_error(reason)}"
end
