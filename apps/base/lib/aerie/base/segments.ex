defmodule Aerie.Base.Segments do
  @moduledoc """
  An append-only store in a folder, as a value with open files: numbered records in files that are named after their first record
  (`0000000000000001.log`). Each is a `Aerie.Base.Segments.Segment`; only the last one is written.

  After `kill -9` nothing is lost that `append/3` has written, after a power cut nothing that was there at a `sync/1`. What the records
  are, when a file is full and what is dropped is its owner's.
  """

  alias Aerie.Base.Files.Raw
  alias Aerie.Base.Segments.Segment

  @enforce_keys [:dir, :extension]
  defstruct [:dir, :extension, segments: []]

  @typedoc "`segments`: the oldest first."
  @type t :: %__MODULE__{dir: Path.t(), extension: String.t(), segments: [Segment.t()]}

  @doc "The store of a folder, with the sizes of its files. None of them is read."
  @spec open(Path.t(), extension :: String.t()) :: {:ok, t()} | {:error, File.posix()}
  def open(dir, extension) do
    store = %__MODULE__{dir: dir, extension: extension}

    with {:ok, names} <- Raw.ls(dir) do
      segments =
        for name <- Enum.sort(names),
            [_name, digits, ^extension] <- [Regex.run(~r/\A(\d{16})(\..+)\z/, name)],
            first = String.to_integer(digits),
            first > 0,
            segment = new(store, first),
            {:ok, %{size: size}} <- [Raw.stat(segment.path)],
            do: %{segment | bytes: size}

      {:ok, %{store | segments: segments}}
    end
  end

  defp new(store, first) do
    name = String.pad_leading("#{first}", 16, "0") <> store.extension
    %Segment{path: Path.join(store.dir, name), first: first}
  end

  @doc """
  Reads all files, so that their counts are known, and cuts off what is torn. A file that has waste after that cannot be written any
  more, or has something else at its end.
  """
  @spec load(t(), Segment.codec()) :: {:ok, t()} | {:error, File.posix()}
  def load(store, codec) do
    Enum.reduce_while(store.segments, {:ok, %{store | segments: []}}, fn segment, {:ok, store} ->
      case Segment.fold(segment, codec, nil, fn _record, nil -> nil end) do
        {:ok, segment, ending, nil} -> {:cont, {:ok, add(store, repair(segment, ending))}}
        error -> {:halt, error}
      end
    end)
  end

  defp repair(segment, {:torn, _rest}),
    do: with({:ok, cut} <- Segment.writer(segment), do: Segment.close(cut), else: (_failed -> segment))

  defp repair(segment, _ending), do: segment

  defp add(store, segment), do: %{store | segments: store.segments ++ [segment]}

  @doc "The file that is written, nil if there is none."
  @spec last(t()) :: Segment.t() | nil
  def last(store), do: List.last(store.segments)

  @doc "The file that has a record; the one behind it if none has it."
  @spec find(t(), pos_integer()) :: Segment.t() | nil
  def find(store, number), do: Enum.find(store.segments, &(number < Segment.next(&1)))

  @doc "The bytes on the disk."
  @spec bytes(t()) :: non_neg_integer()
  def bytes(store) do
    for %{bytes: bytes, waste: waste} when is_integer(bytes) and is_integer(waste) <- store.segments,
        reduce: 0,
        do: (sum -> sum + bytes + waste)
  end

  @doc "Begins a file; the one before it is closed."
  @spec begin(t(), first :: pos_integer()) :: {:ok, t()} | {:error, File.posix()}
  def begin(store, first),
    do:
      with(
        {:ok, segment} <- store |> new(first) |> Segment.writer(),
        do: {:ok, store |> close() |> add(segment)}
      )

  @doc "Writes `count` records to the last file (`Aerie.Base.Segments.Segment.append/3`)."
  @spec append(t(), iodata(), count :: pos_integer()) :: {:ok, t()} | {:error, File.posix(), t()}
  def append(store, iodata, count \\ 1) do
    with {:ok, segment} <- store |> last() |> Segment.writer(),
         {:ok, segment} <- Segment.append(segment, iodata, count) do
      {:ok, put_last(store, segment)}
    else
      {:error, reason} -> {:error, reason, store}
      {:error, reason, segment} -> {:error, reason, put_last(store, segment)}
    end
  end

  @doc "The store whose last file is known better, because its owner has read it."
  @spec put_last(t(), Segment.t()) :: t()
  def put_last(store, segment), do: %{store | segments: List.replace_at(store.segments, -1, segment)}

  @doc "Deletes a file."
  @spec drop(t(), Segment.t()) :: {:ok, t()} | {:error, File.posix()}
  def drop(store, segment), do: with(:ok <- Segment.delete(segment), do: {:ok, forget(store, segment)})

  @doc "The store without a file, which stays on the disk."
  @spec forget(t(), Segment.t()) :: t()
  def forget(store, %{first: first}),
    do: %{store | segments: Enum.reject(store.segments, &(&1.first == first))}

  @doc "Returns when what was written to the last file would survive a power cut."
  @spec sync(t()) :: :ok | {:error, File.posix()}
  def sync(%{segments: []}), do: :ok
  def sync(store), do: store |> last() |> Segment.sync()

  @spec close(t()) :: t()
  def close(%{segments: []} = store), do: store
  def close(store), do: put_last(store, store |> last() |> Segment.close())
end
