defmodule Aerie.Base.Segments.Segment do
  @moduledoc """
  A file that records are appended to, as a value: whole records, and perhaps an unreadable end, which is cut off when the file is opened
  for writing (`writer/1`). It is for its owner alone (mode 0600).
  """

  alias Aerie.Base.Files.Raw

  # No store writes larger ones, and a damaged file may be a single line.
  @max_bytes 1_073_741_824

  @enforce_keys [:path]
  defstruct [:path, :file, first: 1, count: 0, bytes: 0, waste: 0]

  @typedoc """
  `first`: the number of its first record; `count`, `bytes`: of the readable records, once they were read or written; `waste`: bytes of the
  unreadable end; `file`: while it is open for writing.
  """
  @type t :: %__MODULE__{
          path: Path.t(),
          file: :file.fd() | nil,
          first: pos_integer(),
          count: non_neg_integer(),
          bytes: non_neg_integer(),
          waste: non_neg_integer()
        }

  @typedoc "Nothing follows, a record without its end, as a kill or a power cut leaves it, or something else."
  @type ending :: :eof | {:torn, binary()} | :damaged
  @typedoc "Reads the next record from a file."
  @type codec :: (:file.fd() -> {:ok, record :: term(), bytes :: pos_integer()} | ending() | {:error, term()})

  @doc "The codec of text files: a line without its newline."
  @spec line(:file.fd()) :: {:ok, String.t(), pos_integer()} | ending() | {:error, term()}
  def line(file) do
    with {:ok, line} <- :file.read_line(file) do
      text = String.trim_trailing(line, "\n")
      if text == line, do: {:torn, line}, else: {:ok, text, byte_size(line)}
    end
  end

  @doc "The number after the last record."
  @spec next(t()) :: pos_integer()
  def next(%__MODULE__{first: first, count: count}) when is_integer(first) and is_integer(count),
    do: first + count

  @doc "Calls `fun` with each record. The segment that is returned knows how much is readable."
  @spec fold(t(), codec(), acc, (record :: term(), acc -> acc)) ::
          {:ok, t(), ending(), acc} | {:error, File.posix()}
        when acc: term()
  def fold(segment, codec, acc, fun) do
    opened(segment, 0, fn
      file, size when size <= @max_bytes ->
        records(file, codec, fun, acc, %{segment | count: 0, bytes: 0, waste: size})

      _file, _too_large ->
        {:error, :efbig}
    end)
  end

  defp records(file, codec, fun, acc, %{count: count, bytes: bytes, waste: waste} = segment) do
    case codec.(file) do
      {:ok, record, size} ->
        segment = %{segment | count: count + 1, bytes: bytes + size, waste: waste - size}
        records(file, codec, fun, fun.(record, acc), segment)

      # Not from the sum of lines, which may end with two bytes.
      :eof ->
        {:ok, %{segment | bytes: bytes + waste, waste: 0}, :eof, acc}

      {:torn, rest} ->
        waste_now = byte_size(rest)
        {:ok, %{segment | bytes: bytes + waste - waste_now, waste: waste_now}, {:torn, rest}, acc}

      :damaged ->
        {:ok, segment, :damaged, acc}

      error ->
        error
    end
  end

  @doc "At most `limit` records from `offset` on, and their bytes. What cannot be read ends them."
  @spec read(t(), codec(), offset :: non_neg_integer(), limit :: non_neg_integer()) ::
          {[record :: term()], non_neg_integer()}
  def read(segment, codec, offset, limit) do
    found =
      opened(segment, offset, fn file, _size ->
        fn -> codec.(file) end
        |> Stream.repeatedly()
        |> Stream.take(limit)
        |> Enum.take_while(&match?({:ok, _, _}, &1))
      end)

    found = with {:error, _reason} <- found, do: []
    {Enum.map(found, &elem(&1, 1)), found |> Enum.map(&elem(&1, 2)) |> Enum.sum()}
  end

  defp opened(segment, offset, fun) do
    with {:ok, file} <- :file.open(segment.path, [:read, :raw, :binary, read_ahead: 65_536]) do
      result =
        with {:ok, size} <- :file.position(file, :eof),
             {:ok, _offset} <- :file.position(file, offset),
             do: fun.(file, size)

      _ = :file.close(file)
      result
    end
  end

  @doc "Opens the file for `append/3`, or makes it, and cuts off its unreadable end."
  @spec writer(t()) :: {:ok, t()} | {:error, File.posix()}
  def writer(%__MODULE__{file: nil} = segment),
    do: with({:ok, file} <- open(segment.path), do: cut(%{segment | file: file}))

  def writer(segment), do: {:ok, segment}

  defp open(path) do
    case :file.open(path, [:read, :write, :exclusive, :raw, :binary]) do
      {:ok, file} -> with :ok <- Raw.chmod(path, 0o600), do: {:ok, file}
      {:error, :eexist} -> :file.open(path, [:read, :write, :raw, :binary])
      error -> error
    end
  end

  defp cut(%{waste: 0} = segment), do: {:ok, segment}

  defp cut(%{file: file, bytes: bytes} = segment) do
    with {:ok, _position} <- :file.position(file, bytes),
         :ok <- :file.truncate(file),
         do: {:ok, %{segment | waste: 0}}
  end

  @doc """
  Writes `count` records. A write that fails half way (a full disk) is undone. Where that fails too, the segment has waste, over which the
  next record would be written.
  """
  @spec append(t(), iodata(), pos_integer()) :: {:ok, t()} | {:error, File.posix(), t()}
  def append(%{count: before, bytes: bytes, waste: waste} = segment, iodata, count \\ 1) do
    size = IO.iodata_length(iodata)

    with {:error, reason} <- :file.pwrite(segment.file, bytes, iodata) do
      wasted = %{segment | waste: max(waste, size)}

      with {:ok, segment} <- cut(wasted),
           do: {:error, reason, segment},
           else: (_failed -> {:error, reason, wasted})
    else
      :ok -> {:ok, %{segment | count: before + count, bytes: bytes + size, waste: max(waste - size, 0)}}
    end
  end

  @doc "Returns when what was written would survive a power cut."
  @spec sync(t()) :: :ok | {:error, File.posix()}
  def sync(segment), do: if(segment.file, do: :file.datasync(segment.file), else: :ok)

  @spec close(t()) :: t()
  def close(segment) do
    _ = if segment.file, do: :file.close(segment.file)
    %{segment | file: nil}
  end

  @doc "Closes and deletes the file; a missing one is not an error."
  @spec delete(t()) :: :ok | {:error, File.posix()}
  def delete(segment), do: with({:error, :enoent} <- Raw.rm(close(segment).path), do: :ok)
end
