defmodule Aerie.Fleet.Bridge.Events.Outbox do
  @moduledoc """
  Events on disk while NATS is away: append at the end, read from the front, acknowledge in any order.

  A value with open files (`Aerie.Base.Segments`), not a process. Records are numbered 1, 2, 3 … as long as the folder exists. The file `head`
  has the number of the first record that is not acknowledged. Files before it are deleted. If `head` is lost, records are published
  again, which their ids make harmless. Damage ends its file; the records before it are kept.

  If the outbox is full, the oldest file is deleted, and its unacknowledged records are counted as dropped.
  """

  alias Aerie.Fleet.Bridge.Events.Outbox.Record
  alias Aerie.Base.Files.{Format, Private, Raw}
  alias Aerie.Base.Segments
  alias Aerie.Base.Segments.Segment

  @enforce_keys [:store, :max_bytes, :segment_bytes]
  defstruct [
    :store,
    :max_bytes,
    :segment_bytes,
    :cursor,
    head: 1,
    next: 1,
    acked: %{},
    dropped: 0,
    damaged: 0
  ]

  @opaque t :: %__MODULE__{}
  @type seq :: pos_integer()
  @format {"outbox", 1}

  @doc "Kind and version of its folder, what `Aerie.Fleet.Bridge.State.LastPublished` keeps there included."
  @spec format() :: Format.kind()
  def format, do: @format

  @doc """
  Opens or makes an outbox. Options: `:max_bytes` and `:segment_bytes`, both required, and `:gateway`, where damage is
  named.

  Reading starts at the first record that is not acknowledged.
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, File.posix() | String.t()}
  def open(dir, opts) do
    dir = Path.expand(dir)

    with :ok <- Raw.mkdir_p(dir),
         :ok <- Format.mark(opts[:gateway], dir, @format),
         {:ok, store} <- Segments.open(dir, ".log"),
         {:ok, store} <- Segments.load(store, &Record.read/1) do
      {first, next} =
        with [%{first: first} | _] <- store.segments,
             do: {first, Segment.next(Segments.last(store))},
             else: ([] -> {1, 1})

      head = max(read_head(dir) || first, first)

      outbox = %__MODULE__{
        store: store,
        max_bytes: Keyword.fetch!(opts, :max_bytes),
        segment_bytes: Keyword.fetch!(opts, :segment_bytes),
        head: head,
        next: max(next, head),
        damaged: Enum.count(store.segments, &(&1.waste > 0))
      }

      {:ok, outbox |> settle() |> trim() |> rewind()}
    end
  end

  @doc """
  Writes records at the end. An error says how many of them, from the first on, were handled nevertheless.

  A record above #{div(Record.max_bytes(), 1024)} KiB is dropped and counted, because it would block all others for ever.
  """
  @spec append(t(), [Record.t()]) :: {:ok, t()} | {:error, File.posix(), t(), written :: non_neg_integer()}
  def append(outbox, records), do: records |> Enum.map(&Record.encode/1) |> append(outbox, 0)

  defp append([], outbox, _done), do: {:ok, outbox}
  defp append([:too_large | rest], outbox, done), do: append(rest, dropped(outbox, 1), done + 1)

  # In pieces of at most a file, so that the size limit also holds within one long list.
  defp append(encoded, outbox, done) do
    {piece, rest} = piece(encoded, outbox.segment_bytes, [])

    case write(outbox, piece, IO.iodata_length(piece), length(piece)) do
      {:ok, outbox} -> append(rest, outbox, done + length(piece))
      {:error, reason, outbox} -> {:error, reason, outbox, done}
    end
  end

  defp piece([{:ok, bytes} | rest], left, piece) when piece == [] or byte_size(bytes) <= left,
    do: piece(rest, left - byte_size(bytes), [bytes | piece])

  defp piece(rest, _left, piece), do: {Enum.reverse(piece), rest}

  defp dropped(outbox, n), do: %{outbox | dropped: outbox.dropped + n}

  defp write(outbox, bytes, size, count) do
    with {:ok, outbox} <- outbox |> make_room(size) |> rotate(size) do
      case Segments.append(outbox.store, bytes, count) do
        {:ok, store} ->
          {:ok, %{outbox | store: store, next: outbox.next + count}}

        {:error, reason, store} ->
          {:error, reason, unreadable(%{outbox | store: store}, Segments.last(store))}
      end
    end
  end

  # Half a record that could not be removed ends its file. One without any readable record is deleted, because the next takes its number.
  defp unreadable(outbox, %{waste: 0}), do: outbox

  defp unreadable(outbox, segment) do
    with 0 <- segment.count,
         {:ok, store} <- Segments.drop(outbox.store, segment),
         do: %{outbox | store: store},
         else: (_kept -> %{outbox | damaged: outbox.damaged + 1})
  end

  defp make_room(%{store: %{segments: [oldest | _]}} = outbox, size) do
    if Segments.bytes(outbox.store) + size > outbox.max_bytes,
      do: outbox |> lose(oldest.first..(Segment.next(oldest) - 1)//1) |> drop(oldest) |> make_room(size),
      else: outbox
  end

  defp make_room(outbox, _size), do: outbox

  # Lost records count as acknowledged.
  defp lose(outbox, seqs) do
    lost = Enum.filter(seqs, &pending?(outbox, &1))
    outbox |> dropped(length(lost)) |> ack(lost)
  end

  # One that cannot be deleted is found again at the next start.
  defp drop(outbox, segment) do
    case Segments.drop(outbox.store, segment) do
      {:ok, store} -> %{outbox | store: store}
      {:error, _reason} -> %{outbox | store: Segments.forget(outbox.store, segment)}
    end
  end

  defp rotate(outbox, size) do
    case Segments.last(outbox.store) do
      %Segment{waste: 0, bytes: bytes} when bytes == 0 or bytes + size <= outbox.segment_bytes ->
        {:ok, outbox}

      last ->
        begin(outbox, last)
    end
  end

  defp begin(outbox, last) do
    # A damaged file without a readable record already has that number, so it is skipped, as in `settle/1` and `read/2`.
    first = if last != nil and last.first >= outbox.next, do: last.first + 1, else: outbox.next

    case Segments.begin(outbox.store, first) do
      {:ok, store} -> {:ok, %{outbox | store: store, next: first}}
      {:error, reason} -> {:error, reason, outbox}
    end
  end

  defp pending?(outbox, seq), do: seq >= outbox.head and not is_map_key(outbox.acked, seq)

  @doc "At most `limit` unread, unacknowledged records, oldest first. They then count as read."
  @spec read(t(), pos_integer()) :: {[{seq(), Record.t()}], t()}
  def read(%{cursor: %{seq: seq}, head: head} = outbox, limit) when seq < head,
    do: outbox |> cursor(head) |> read(limit, [])

  def read(outbox, limit), do: read(outbox, limit, [])

  defp read(%{cursor: %{seq: seq}} = outbox, left, chunks) when left <= 0 or seq >= outbox.next,
    do: {chunks |> Enum.reverse() |> Enum.concat(), outbox}

  defp read(%{cursor: %{seq: seq, offset: offset}} = outbox, left, chunks) do
    segment = Segments.find(outbox.store, seq)
    # A gap (a segment that was damaged or dropped) is skipped.
    {seq, offset} = if seq <= segment.first, do: {segment.first, 0}, else: {seq, offset}

    # No more than are counted: a record that was not written to its end may follow.
    case Segment.read(segment, &Record.read/1, offset, min(left, Segment.next(segment) - seq)) do
      {[], 0} ->
        # A part that was readable before is not any more: the rest of this segment is lost.
        after_it = Segment.next(segment)
        outbox = lose(%{outbox | damaged: outbox.damaged + 1}, seq..(after_it - 1)//1)
        read(%{outbox | cursor: %{seq: after_it, offset: 0}}, left, chunks)

      {records, bytes} ->
        wanted = for {record, seq} <- Enum.with_index(records, seq), pending?(outbox, seq), do: {seq, record}
        cursor = %{seq: seq + length(records), offset: offset + bytes}
        read(%{outbox | cursor: cursor}, left - length(wanted), [wanted | chunks])
    end
  end

  @doc "Starts reading again at the first record that is not acknowledged."
  @spec rewind(t()) :: t()
  def rewind(outbox), do: cursor(outbox, outbox.head)

  # The offset of a record within its file is found by reading up to it.
  defp cursor(outbox, seq) do
    {_records, offset} =
      with %Segment{first: first} = segment when first < seq <- Segments.find(outbox.store, seq),
           do: Segment.read(segment, &Record.read/1, 0, seq - first),
           else: (_none -> {[], 0})

    %{outbox | cursor: %{seq: seq, offset: offset}}
  end

  @doc "Acknowledges records. Unknown and repeated numbers are ignored."
  @spec ack(t(), [seq()]) :: t()
  def ack(outbox, []), do: outbox

  def ack(outbox, seqs) do
    acked = for seq <- seqs, seq >= outbox.head, seq < outbox.next, into: outbox.acked, do: {seq, true}
    settled = settle(%{outbox | acked: acked})
    # If the head cannot be written, records are published again after a restart.
    _ = if settled.head != outbox.head, do: write_head(settled)
    trim(settled)
  end

  # Moves the head past acknowledged records, and past numbers that no segment has (the end of a damaged one).
  defp settle(outbox) do
    {head, acked} = advance(outbox.head, outbox.acked)
    outbox = %{outbox | head: head, acked: acked}

    case Segments.find(outbox.store, head) do
      %Segment{first: first} when first > head -> settle(%{outbox | head: first})
      _ -> outbox
    end
  end

  defp advance(head, acked) do
    if is_map_key(acked, head), do: advance(head + 1, Map.delete(acked, head)), else: {head, acked}
  end

  # Deletes files before the head, the last one too once all of it is acknowledged: an empty outbox has none.
  defp trim(%{store: %{segments: [segment | rest]}} = outbox) do
    if Segment.next(segment) <= outbox.head and (rest != [] or segment.count > 0),
      do: outbox |> drop(segment) |> trim(),
      else: outbox
  end

  defp trim(outbox), do: outbox

  @doc "Syncs what was written to the disk."
  @spec sync(t()) :: t()
  def sync(outbox) do
    _ = Segments.sync(outbox.store)
    outbox
  end

  @doc "Closes the files."
  @spec close(t()) :: :ok
  def close(outbox) do
    _ = outbox |> sync() |> Map.fetch!(:store) |> Segments.close()
    :ok
  end

  @doc """
  `events`: not acknowledged; `bytes`, `segments`: on disk; `dropped`: since it was opened, because it was full or unreadable;
  `damaged`: segments with an unreadable end.
  """
  @spec stats(t()) :: %{(:events | :bytes | :segments | :dropped | :damaged) => non_neg_integer()}
  def stats(%{store: store, head: head} = outbox) do
    held = for segment <- store.segments, do: max(Segment.next(segment) - max(segment.first, head), 0)

    %{
      events: max(Enum.sum(held) - map_size(outbox.acked), 0),
      bytes: Segments.bytes(store),
      segments: length(store.segments),
      dropped: outbox.dropped,
      damaged: outbox.damaged
    }
  end

  @doc "Whether every record is acknowledged."
  @spec empty?(t()) :: boolean()
  def empty?(outbox), do: stats(outbox).events == 0

  defp read_head(dir) do
    case Raw.read(Path.join(dir, "head")) do
      {:ok, <<seq::64, crc::32>>} -> if :erlang.crc32(<<seq::64>>) == crc, do: seq
      _ -> nil
    end
  end

  defp write_head(%{head: head, store: store}),
    do: Private.write(Path.join(store.dir, "head"), <<head::64, :erlang.crc32(<<head::64>>)::32>>, false)
end
