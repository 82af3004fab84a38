defmodule Aerie.Bridge.Outbox.Segment do
  @moduledoc "One file of the outbox: records `first` to `first + count - 1`, one after another."

  alias Aerie.Bridge.Outbox.Record

  @enforce_keys [:path, :first]
  defstruct [:path, :first, count: 0, bytes: 0, waste: 0, damaged: false]

  @typedoc """
  `bytes`: of the readable part; `damaged`: an unreadable part follows it, so nothing is appended; `waste`: bytes of that
  part.
  """
  @type t :: %__MODULE__{
          path: Path.t(),
          first: pos_integer(),
          count: non_neg_integer(),
          bytes: non_neg_integer(),
          waste: non_neg_integer(),
          damaged: boolean()
        }

  @doc "The number in a segment's file name, or nil for any other file."
  @spec number(String.t()) :: pos_integer() | nil
  def number(name) do
    with [_, digits] <- Regex.run(~r/\A(\d{16})\.log\z/, name),
         number when number > 0 <- String.to_integer(digits) do
      number
    else
      _ -> nil
    end
  end

  @doc "A segment without a file."
  @spec new(Path.t(), pos_integer()) :: t()
  def new(dir, first) do
    name = first |> Integer.to_string() |> String.pad_leading(16, "0")
    %__MODULE__{path: Path.join(dir, name <> ".log"), first: first}
  end

  @doc "Loads a segment from its file. A record that is cut off at the end is removed."
  @spec load(Path.t(), pos_integer()) :: {:ok, t()} | {:error, File.posix()}
  def load(dir, first) do
    segment = new(dir, first)

    with {:ok, bytes} <- File.read(segment.path) do
      {records, why} = Record.decode(bytes, :all)
      readable = records |> Enum.map(&elem(&1, 1)) |> Enum.sum()
      segment = %{segment | count: length(records), bytes: readable}

      case why do
        :end -> {:ok, segment}
        :cut -> {:ok, cut(segment, byte_size(bytes))}
        :damaged -> {:ok, %{segment | damaged: true, waste: byte_size(bytes) - readable}}
      end
    end
  end

  @doc "The number after the last record."
  @spec next(t()) :: pos_integer()
  def next(%__MODULE__{first: first, count: count}) when is_integer(first) and is_integer(count),
    do: first + count

  @doc "Opens the file for `append/5`."
  @spec open_writer(t()) :: {:ok, :file.fd()} | {:error, File.posix()}
  def open_writer(segment), do: :file.open(segment.path, [:append, :raw, :binary])

  @doc """
  Writes records. A write that fails half way (a full disk) is undone; if that fails too, the returned segment is damaged.
  """
  @spec append(t(), :file.fd(), iodata(), pos_integer(), pos_integer()) ::
          {:ok, t()} | {:error, File.posix(), t()}
  def append(segment, writer, iodata, count, bytes) do
    case :file.write(writer, iodata) do
      :ok ->
        {:ok, %{segment | count: segment.count + count, bytes: segment.bytes + bytes}}

      {:error, reason} ->
        {:error, reason, cut(segment, segment.bytes + bytes)}
    end
  end

  @doc "At most `length` bytes of the readable part, from `offset` on."
  @spec read(t(), non_neg_integer(), pos_integer()) :: {:ok, binary()} | {:error, term()}
  def read(segment, offset, length) do
    with {:ok, file} <- :file.open(segment.path, [:read, :raw, :binary]) do
      result = :file.pread(file, offset, min(length, max(segment.bytes - offset, 0)))
      _ = :file.close(file)
      with :eof <- result, do: {:ok, <<>>}
    end
  end

  @doc "Deletes the file; a missing one is no error."
  @spec delete(t()) :: :ok | {:error, File.posix()}
  def delete(segment) do
    with {:error, :enoent} <- File.rm(segment.path), do: :ok
  end

  # Removes the unreadable end; the file has at most `size` bytes. If that fails, nothing may be appended.
  defp cut(segment, size) do
    case truncate(segment) do
      :ok -> segment
      {:error, _reason} -> %{segment | damaged: true, waste: size - segment.bytes}
    end
  end

  defp truncate(segment) do
    with {:ok, file} <- :file.open(segment.path, [:read, :write, :raw, :binary]) do
      result = with {:ok, _position} <- :file.position(file, segment.bytes), do: :file.truncate(file)
      closed = :file.close(file)
      with :ok <- result, do: closed
    end
  end
end
