defmodule Aerie.Fleet.Tracks.Files do
  @moduledoc """
  The folder of the tracks, as a value with an open file: one file an hour (`Aerie.Base.Segments`), named after the
  second of its first group. Its index is a table of the store:

      {{file, at}, path, offset, bytes}    a group: its time (unix milliseconds), and its first block
      {:status, status}

  A file that is damaged is read up to the damage and not written any more. When all files together reach the limit,
  the oldest goes.
  """

  alias Aerie.Base.Files.{Format, Private}
  alias Aerie.Base.{Segments, Store}
  alias Aerie.Base.Segments.Segment
  alias Aerie.Fleet.Tracks.Block

  @extension ".tracks"
  @format {"tracks", 1}
  # Then an hour has several files, so that little goes at once when they make room.
  @parts 8

  @enforce_keys [:gateway, :store, :max_bytes, :keep_ms]
  defstruct @enforce_keys

  @type t :: %__MODULE__{}

  @doc "The table that the store owns for the index."
  @spec table() :: Store.table()
  def table, do: {:tracks, [:ordered_set, read_concurrency: true], []}

  @doc "Kind and version of the folder."
  @spec format() :: Format.kind()
  def format, do: @format

  @doc "Opens or makes the folder and reads the files once, for the index. Returns how many of them are damaged."
  @spec open(term(), Path.t(), max_bytes: pos_integer(), keep_ms: pos_integer()) ::
          {:ok, t(), damaged :: non_neg_integer()} | {:error, File.posix() | String.t()}
  def open(gateway, dir, limits) do
    with :ok <- Private.folder(dir),
         :ok <- Format.mark(gateway, dir, @format),
         {:ok, store} <- Segments.open(dir, @extension) do
      :ets.match_delete(Store.table!(gateway, :tracks), {{:_, :_}, :_, :_, :_})
      files = struct!(%__MODULE__{gateway: gateway, store: store, max_bytes: 0, keep_ms: 0}, limits)
      {segments, damaged} = Enum.map_reduce(store.segments, 0, &index(&1, &2, files))
      {:ok, %{files | store: %{store | segments: segments}}, damaged}
    end
  end

  defp index(segment, damaged, files) do
    found =
      Segment.fold(segment, &Block.read/1, {0, []}, fn
        {{:group, at}, bytes}, {offset, groups} -> {offset + bytes, [{at, offset, bytes} | groups]}
        {:block, bytes}, {offset, groups} -> {offset + bytes, groups}
      end)

    case found do
      {:ok, segment, ending, {_end, groups}} ->
        for {at, offset, bytes} <- groups, do: put(files, segment, at, offset, bytes)
        {cut(segment, ending), damaged + if(ending == :damaged, do: 1, else: 0)}

      {:error, _reason} ->
        {segment, damaged + 1}
    end
  end

  # What a kill left half written. Anything else stays as it is.
  defp cut(segment, {:torn, _rest}),
    do: with({:ok, cut} <- Segment.writer(segment), do: Segment.close(cut), else: (_failed -> segment))

  defp cut(segment, _ending), do: segment

  defp put(%{gateway: gateway}, segment, at, offset, bytes),
    do: :ets.insert(Store.table!(gateway, :tracks), {{segment.first, at}, segment.path, offset, bytes})

  @doc "Whether the next block has to begin a group, because it will be in another file."
  @spec full?(t(), at :: non_neg_integer()) :: boolean()
  def full?(files, at), do: not goes_on?(files, at, 0)

  defp goes_on?(files, at, size) do
    case Segments.last(files.store) do
      %{waste: 0, bytes: bytes, first: first} ->
        hour(first * 1000) == hour(at) and bytes + size <= div(files.max_bytes, @parts)

      _none_or_damaged ->
        false
    end
  end

  defp hour(at), do: div(at, 3_600_000)

  @doc "Writes a block. Returns the hours of files that made room before their time (0 where none did)."
  @spec write(t(), at :: non_neg_integer(), begins? :: boolean(), iodata()) ::
          {:ok, t(), early :: non_neg_integer()} | {:error, File.posix(), t()}
  def write(files, at, begins?, block) do
    size = IO.iodata_length(block)

    with {:ok, files} <- if(begins?, do: rotate(files, at, size), else: {:ok, files}),
         offset = Segments.last(files.store).bytes,
         {:ok, store} <- Segments.append(files.store, block) do
      files = %{files | store: store}
      if begins?, do: put(files, Segments.last(store), at, offset, size)
      # At each group, and not at each block: a power cut may cost a minute.
      _ = if begins?, do: Segments.sync(store)
      {files, early} = files |> expire(at) |> make_room(0)
      {:ok, files, early}
    else
      {:error, reason, store} -> {:error, reason, %{files | store: store}}
      {:error, reason} -> {:error, reason, files}
    end
  end

  defp rotate(files, at, size) do
    if goes_on?(files, at, size) do
      {:ok, files}
    else
      last = Segments.last(files.store)
      first = max(div(at, 1000), if(last, do: last.first + 1, else: 1))
      with {:ok, store} <- Segments.begin(files.store, first), do: {:ok, %{files | store: store}}
    end
  end

  # A file is too old when the one after it is. The one that is written stays.
  defp expire(%{store: %{segments: [oldest, next | _]}} = files, at) do
    if next.first * 1000 <= at - files.keep_ms, do: files |> drop(oldest) |> expire(at), else: files
  end

  defp expire(files, _at), do: files

  defp make_room(%{store: %{segments: [oldest, _next | _]} = store} = files, early) do
    if Segments.bytes(store) > files.max_bytes,
      do: files |> drop(oldest) |> make_room(early + 1),
      else: {files, early}
  end

  defp make_room(files, early), do: {files, early}

  # One that cannot be deleted is found again at the next start.
  defp drop(files, segment) do
    :ets.match_delete(Store.table!(files.gateway, :tracks), {{segment.first, :_}, :_, :_, :_})

    case Segments.drop(files.store, segment) do
      {:ok, store} -> %{files | store: store}
      {:error, _reason} -> %{files | store: Segments.forget(files.store, segment)}
    end
  end

  @doc "The bytes of all files."
  @spec bytes(t()) :: non_neg_integer()
  def bytes(files), do: Segments.bytes(files.store)

  @spec close(t()) :: :ok
  def close(files) do
    _ = Segments.sync(files.store)
    _ = Segments.close(files.store)
    :ok
  end
end
