defmodule Aerie.Control.Ledger.Journal do
  @moduledoc """
  The ledger's file: a line with its format, then one record per line, preceded by its CRC-32.

      aerie-ledger 1
      8f2a90c1 ["new","a1","…",1795339800000000,{…}]

  An incomplete last line was never answered and is cut off. A line that is damaged in any other way is left out, and the
  damaged file is kept beside the new one. A file without such a beginning is not a ledger any more; the opener sets it aside. The file is rewritten (`compact/2`) when most of it is out of date.
  """

  alias Aerie.Base.Files.{Disk, Format, Private, Raw}
  alias Aerie.Base.Segments.Segment

  @format 1
  @head "aerie-ledger #{@format}"
  @max_line 65_536

  @type t :: Segment.t()

  @doc """
  Opens the file of a folder; `fun` gets each record. Returns how many damaged lines were left out. A file of a newer format is
  refused and left alone; `{:error, :damaged}` if the file is none of a ledger.
  """
  @spec open(Path.t(), acc, ([term()], acc -> acc)) ::
          {:ok, t(), acc, damaged :: non_neg_integer()} | {:error, String.t() | :damaged}
        when acc: term()
  def open(dir, acc, fun) do
    path = path(dir)

    with :ok <- Private.folder(dir),
         :ok <- head(path),
         {:ok, journal, {acc, damaged}} <- read(path, acc, fun),
         :ok <- keep(path, damaged),
         {:ok, journal} <- begin(journal) do
      {:ok, journal, acc, damaged}
    else
      {:error, reason} -> {:error, text(path, reason)}
    end
  end

  @doc "Calls `fun` with each record of a folder's file, which stays as it is. A folder without one is an error."
  @spec fold(Path.t(), acc, ([term()], acc -> acc)) ::
          {:ok, acc, damaged :: non_neg_integer()} | {:error, String.t()}
        when acc: term()
  def fold(dir, acc, fun) do
    path = path(dir)

    with :ok <- head(path),
         {:ok, _journal, _ending, {acc, damaged}} <-
           Segment.fold(%Segment{path: path}, &Segment.line/1, {acc, 0}, &record(&1, &2, fun)) do
      {:ok, acc, damaged}
    else
      {:error, :damaged} -> {:error, "#{path}: not a ledger: expected a first line #{@head}"}
      {:error, reason} -> {:error, text(path, reason)}
    end
  end

  @doc "The file of a folder."
  @spec path(Path.t()) :: Path.t()
  def path(dir), do: Path.join(dir, "ledger")

  @doc "Whether the file of a folder, if there is one, is of a format that this version reads."
  @spec check(Path.t()) :: :ok | {:error, String.t()}
  def check(dir) do
    # Other damage is found when it is opened.
    with {:error, text} when is_binary(text) <- dir |> path() |> head(),
         do: {:error, text},
         else: (_other -> :ok)
  end

  # None, or one that was torn when it was created, is a ledger too.
  defp head(path) do
    with {:ok, result} <- File.open(path, [:read, :raw, :binary], &:file.read(&1, 64)),
         {:ok, bytes} <- result,
         [first | _] = String.split(bytes, "\n", parts: 2),
         false <- first == @head or String.starts_with?(@head, bytes) do
      # A whole number, and not this one, is not damage.
      with "aerie-ledger " <> version <- first, {n, ""} when n > @format <- Integer.parse(version) do
        {:error, Format.newer(path, "ledger", "of another format", @format)}
      else
        _other -> {:error, :damaged}
      end
    else
      {:error, reason} when reason != :enoent -> {:error, reason}
      _none_empty_or_ours -> :ok
    end
  end

  @doc "Writes records. A write that fails half way is undone."
  @spec append(t(), [[term()]]) :: {:ok, t()} | {:error, String.t(), t()}
  def append(journal, []), do: {:ok, journal}

  def append(journal, records) do
    with {:error, reason, journal} <- Segment.append(journal, Enum.map(records, &line/1), length(records)),
         do: {:error, text(journal.path, reason), journal}
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

    with {:ok, file} <- begin(%Segment{path: new}),
         {:ok, file} <- fill(file, records),
         :ok <- Segment.sync(file),
         :ok <- File.rename(new, journal.path) do
      _ = Segment.close(journal)
      {:ok, %{file | path: journal.path}}
    else
      failed ->
        _ = File.rm(new)
        {:error, text(new, elem(failed, 1)), journal}
    end
  end

  @spec close(t()) :: :ok
  def close(journal) do
    _ = Segment.sync(journal)
    _ = Segment.close(journal)
    :ok
  end

  defp fill(file, records) do
    records
    |> Stream.chunk_every(500)
    |> Enum.reduce_while({:ok, file}, fn some, {:ok, file} ->
      case Segment.append(file, Enum.map(some, &line/1), length(some)) do
        {:ok, file} -> {:cont, {:ok, file}}
        failed -> {:halt, failed}
      end
    end)
  end

  defp line(record) do
    json = JSON.encode!(record)
    [crc(json), " ", json, "\n"]
  end

  defp crc(json),
    do: json |> :erlang.crc32() |> Integer.to_string(16) |> String.pad_leading(8, "0") |> String.downcase()

  defp read(path, acc, fun) do
    file = %Segment{path: path}

    case Segment.fold(file, &Segment.line/1, {acc, 0}, &record(&1, &2, fun)) do
      {:ok, journal, _ending, result} -> {:ok, journal, result}
      {:error, :enoent} -> {:ok, file, {acc, 0}}
      error -> error
    end
  end

  defp record(@head, result, _fun), do: result

  defp record(line, {acc, damaged}, fun) do
    with true <- byte_size(line) < @max_line,
         <<crc::binary-size(8), " ", json::binary>> <- line,
         ^crc <- crc(json),
         {:ok, [_ | _] = record} <- JSON.decode(json) do
      {fun.(record, acc), damaged}
    else
      _other -> {acc, damaged + 1}
    end
  end

  defp keep(_path, 0), do: :ok

  # One copy is enough: the first damage is the one to examine.
  defp keep(path, _damaged) do
    with {:ok, _bytes} <- File.copy(path, path <> ".damaged"), do: File.chmod(path <> ".damaged", 0o600)
  end

  # With its own mode, whatever the umask was.
  defp begin(journal) do
    with {:ok, journal} <- Segment.writer(journal),
         :ok <- Raw.chmod(journal.path, 0o600),
         do: first_line(journal)
  end

  defp first_line(%{bytes: 0} = journal),
    do: with({:error, reason, _journal} <- Segment.append(journal, [@head, "\n"]), do: {:error, reason})

  defp first_line(journal), do: {:ok, journal}

  defp text(_path, said) when is_binary(said) or said == :damaged, do: said
  defp text(path, reason), do: "#{path}: #{:file.format_error(reason)}"
end
