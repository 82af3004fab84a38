defmodule Aerie.Bridge.Outbox do
  @moduledoc """
  Events on disk while NATS is away: append at the end, read from the front, acknowledge in any order.

  A value with open files, not a process. The folder has segment files, each named after the number of its first record;
  records are numbered 1, 2, 3 … as long as the folder exists. The file `head` has the number of the first record that
  is not acknowledged. Segments before it are deleted.

  After `kill -9` of the VM nothing is lost that `append/2` has written (the system has the data); after a power cut, what was
  not synced (`sync/1`). A record that is cut off or damaged ends its segment; those before it are kept. If `head` is lost,
  records are published again, which their ids make harmless.

  If the outbox is full, the oldest segment is deleted, and its unacknowledged records are counted as dropped.
  """

  alias Aerie.Bridge.Outbox.{Record, Segment}
  alias Aerie.DiskFormat

  @enforce_keys [:dir, :max_bytes, :segment_bytes]
  defstruct [
    :dir,
    :max_bytes,
    :segment_bytes,
    :writer,
    :cursor,
    segments: [],
    head: 1,
    next: 1,
    acked: %{},
    dropped: 0,
    damaged: 0,
    unsynced: false
  ]

  @opaque t :: %__MODULE__{}
  @type seq :: pos_integer()
  @read_bytes 2 * 131_072
  @format {"outbox", 1}

  @doc "Kind and version of its folder, what `Aerie.Bridge.LastPublished` keeps there included."
  @spec format() :: DiskFormat.kind()
  def format, do: @format

  @doc """
  Opens or makes an outbox. Options, both required: `:max_bytes`, `:segment_bytes`.

  Reading starts at the first record that is not acknowledged.
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, File.posix() | String.t()}
  def open(dir, opts) do
    outbox = %__MODULE__{
      dir: Path.expand(dir),
      max_bytes: Keyword.fetch!(opts, :max_bytes),
      segment_bytes: Keyword.fetch!(opts, :segment_bytes)
    }

    with :ok <- File.mkdir_p(outbox.dir),
         :ok <- DiskFormat.mark(outbox.dir, @format),
         {:ok, names} <- File.ls(outbox.dir) do
      numbers = names |> Enum.flat_map(&List.wrap(Segment.number(&1))) |> Enum.sort()
      load(outbox, numbers, read_head(outbox))
    end
  end

  defp load(outbox, numbers, head) do
    Enum.reduce_while(numbers, {:ok, []}, fn number, {:ok, segments} ->
      case Segment.load(outbox.dir, number) do
        {:ok, segment} -> {:cont, {:ok, [segment | segments]}}
        {:error, reason} -> {:halt, {:error, reason}}
      end
    end)
    |> case do
      {:ok, segments} ->
        segments = Enum.reverse(segments)
        first = if segments == [], do: head || 1, else: hd(segments).first
        last = if segments == [], do: 0, else: Segment.next(List.last(segments)) - 1
        head = max(head || first, first)
        damaged = Enum.count(segments, & &1.damaged)
        outbox = %{outbox | segments: segments, head: head, next: max(last + 1, head), damaged: damaged}
        {:ok, outbox |> settle() |> trim() |> rewind()}

      error ->
        error
    end
  end

  @doc """
  Writes records at the end. An error says how many of them, from the first on, were handled nevertheless.

  A record above #{div(Record.max_bytes(), 1024)} KiB is dropped and counted, because it would block all others for ever.
  """
  @spec append(t(), [Record.t()]) :: {:ok, t()} | {:error, File.posix(), t(), written :: non_neg_integer()}
  def append(outbox, []), do: {:ok, outbox}

  def append(outbox, records) do
    {encoded, too_large} =
      records
      |> Enum.with_index(1)
      |> Enum.reduce({[], []}, fn {record, place}, {encoded, too_large} ->
        case Record.encode(record) do
          {:ok, bytes} -> {[{bytes, place} | encoded], too_large}
          :too_large -> {encoded, [place | too_large]}
        end
      end)

    # In pieces of at most a segment, so that the size limit also holds within one long list.
    case encoded |> Enum.reverse() |> pieces(outbox.segment_bytes) |> write(outbox, 0) do
      {:ok, outbox} ->
        {:ok, dropped(outbox, length(too_large))}

      {:error, reason, outbox, written} ->
        {:error, reason, dropped(outbox, Enum.count(too_large, &(&1 <= written))), written}
    end
  end

  defp dropped(outbox, n), do: %{outbox | dropped: outbox.dropped + n}

  # Each piece: its bytes, their size, the number of its records, and the place of the last one in the list.
  defp pieces(encoded, size) do
    Enum.chunk_while(
      encoded,
      {[], 0, 0, 0},
      fn {bytes, place}, {piece, sum, n, last} ->
        if piece != [] and sum + byte_size(bytes) > size,
          do: {:cont, {Enum.reverse(piece), sum, n, last}, {[bytes], byte_size(bytes), 1, place}},
          else: {:cont, {[bytes | piece], sum + byte_size(bytes), n + 1, place}}
      end,
      fn
        {[], _sum, _n, _last} -> {:cont, []}
        {piece, sum, n, last} -> {:cont, {Enum.reverse(piece), sum, n, last}, []}
      end
    )
  end

  defp write([], outbox, _written), do: {:ok, outbox}

  defp write([{_bytes, size, _n, last} = piece | rest], outbox, written) do
    with {:ok, outbox} <- outbox |> make_room(size) |> writable(size),
         {:ok, outbox} <- put(outbox, piece) do
      write(rest, outbox, last)
    else
      {:error, reason, outbox} -> {:error, reason, outbox, written}
    end
  end

  defp put(outbox, {bytes, size, n, _last}) do
    case Segment.append(List.last(outbox.segments), outbox.writer, bytes, n, size) do
      {:ok, segment} ->
        outbox = put_last(outbox, segment)
        {:ok, %{outbox | next: outbox.next + n, unsynced: true}}

      # Closed, so that the next try opens the segment again, or the next one if half a record could not be removed.
      {:error, reason, segment} ->
        {:error, reason, outbox |> close_writer() |> put_last(segment) |> drop_unreadable(segment)}
    end
  end

  defp put_last(outbox, segment), do: %{outbox | segments: List.replace_at(outbox.segments, -1, segment)}

  # A file without any readable record is deleted, because the next segment takes its number.
  defp drop_unreadable(outbox, %Segment{damaged: true, count: 0} = ruin) do
    case Segment.delete(ruin) do
      :ok -> %{outbox | segments: List.delete_at(outbox.segments, -1)}
      {:error, _reason} -> %{outbox | damaged: outbox.damaged + 1}
    end
  end

  defp drop_unreadable(outbox, %Segment{damaged: true}), do: %{outbox | damaged: outbox.damaged + 1}
  defp drop_unreadable(outbox, _sound), do: outbox

  defp make_room(%{segments: [oldest | rest]} = outbox, bytes) do
    if bytes(outbox) + bytes > outbox.max_bytes do
      lost = Enum.count(oldest.first..(Segment.next(oldest) - 1)//1, &pending?(outbox, &1))
      outbox = if rest == [], do: close_writer(outbox), else: outbox
      _ = Segment.delete(oldest)
      after_it = Segment.next(oldest)
      head = max(outbox.head, after_it)
      outbox = %{outbox | segments: rest, head: head, dropped: outbox.dropped + lost}
      outbox = if outbox.cursor.seq < after_it, do: cursor(outbox, after_it), else: outbox
      make_room(settle(%{outbox | acked: Map.filter(outbox.acked, fn {seq, true} -> seq >= head end)}), bytes)
    else
      outbox
    end
  end

  defp make_room(outbox, _bytes), do: outbox

  defp pending?(outbox, seq), do: seq >= outbox.head and not is_map_key(outbox.acked, seq)

  defp writable(outbox, bytes) do
    case List.last(outbox.segments) do
      %Segment{damaged: false} = segment
      when segment.bytes == 0 or segment.bytes + bytes <= outbox.segment_bytes ->
        with_writer(outbox, segment)

      _full_damaged_or_none ->
        outbox = close_writer(outbox)
        first = first_of_next(outbox)
        segment = Segment.new(outbox.dir, first)

        case with_writer(%{outbox | segments: outbox.segments ++ [segment], next: first}, segment) do
          {:ok, outbox} -> {:ok, outbox}
          {:error, reason, _} -> {:error, reason, outbox}
        end
    end
  end

  # A damaged file without a readable record already has that number, so it is skipped, as in `settle/1` and `read/2`.
  defp first_of_next(outbox) do
    case List.last(outbox.segments) do
      %Segment{first: first} when first >= outbox.next -> first + 1
      _before_it -> outbox.next
    end
  end

  defp with_writer(%{writer: nil} = outbox, segment) do
    case Segment.open_writer(segment) do
      {:ok, writer} -> {:ok, %{outbox | writer: writer}}
      {:error, reason} -> {:error, reason, outbox}
    end
  end

  defp with_writer(outbox, _segment), do: {:ok, outbox}

  defp close_writer(%{writer: nil} = outbox), do: outbox

  defp close_writer(outbox) do
    _ = :file.close(outbox.writer)
    %{outbox | writer: nil}
  end

  @doc "At most `limit` unread, unacknowledged records, oldest first. They then count as read."
  @spec read(t(), pos_integer()) :: {[{seq(), Record.t()}], t()}
  def read(%{cursor: %{seq: seq}, head: head} = outbox, limit) when seq < head,
    do: outbox |> cursor(head) |> read(limit, [])

  def read(outbox, limit), do: read(outbox, limit, [])

  defp read(%{cursor: %{seq: seq}} = outbox, left, chunks) when left <= 0 or seq >= outbox.next,
    do: {chunks |> Enum.reverse() |> Enum.concat(), outbox}

  defp read(%{cursor: cursor} = outbox, left, chunks) do
    segment = Enum.find(outbox.segments, &(cursor.seq < Segment.next(&1)))
    # A gap (a segment that was damaged or dropped) is skipped.
    cursor = if cursor.seq < segment.first, do: %{seq: segment.first, offset: 0}, else: cursor
    cursor = if cursor.seq == segment.first, do: %{cursor | offset: 0}, else: cursor

    records =
      case Segment.read(segment, cursor.offset, @read_bytes) do
        {:ok, bytes} -> bytes |> Record.decode(left) |> elem(0)
        {:error, _reason} -> []
      end

    case records do
      [] ->
        # What was readable before is no longer: the rest of this segment is lost.
        lost = Segment.next(segment) - cursor.seq
        outbox = %{outbox | damaged: outbox.damaged + 1, dropped: outbox.dropped + lost}
        outbox = ack(outbox, Enum.to_list(cursor.seq..(Segment.next(segment) - 1)))
        read(%{outbox | cursor: %{seq: Segment.next(segment), offset: 0}}, left, chunks)

      records ->
        numbered = Enum.with_index(records, fn {record, _size}, i -> {cursor.seq + i, record} end)
        wanted = Enum.filter(numbered, fn {seq, _record} -> pending?(outbox, seq) end)
        read_bytes = records |> Enum.map(&elem(&1, 1)) |> Enum.sum()
        cursor = %{seq: cursor.seq + length(records), offset: cursor.offset + read_bytes}
        read(%{outbox | cursor: cursor}, left - length(wanted), [wanted | chunks])
    end
  end

  @doc "Starts reading again at the first record that is not acknowledged."
  @spec rewind(t()) :: t()
  def rewind(outbox), do: cursor(outbox, outbox.head)

  # The offset of a record within its segment is found by reading up to it.
  defp cursor(outbox, seq) do
    offset =
      with %Segment{} = segment <- Enum.find(outbox.segments, &(seq in &1.first..(Segment.next(&1) - 1)//1)),
           {:ok, bytes} <- Segment.read(segment, 0, segment.bytes) do
        {records, _why} = Record.decode(bytes, seq - segment.first)
        records |> Enum.map(&elem(&1, 1)) |> Enum.sum()
      else
        _ -> 0
      end

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

    case Enum.find(outbox.segments, &(head < Segment.next(&1))) do
      %Segment{first: first} when first > head -> settle(%{outbox | head: first})
      _ -> outbox
    end
  end

  defp advance(head, acked) do
    if is_map_key(acked, head), do: advance(head + 1, Map.delete(acked, head)), else: {head, acked}
  end

  # Deletes segments before the head, the last one too once all of it is acknowledged: an empty outbox has no segments.
  defp trim(%{segments: [segment | rest]} = outbox) do
    if Segment.next(segment) <= outbox.head and (rest != [] or segment.count > 0) do
      outbox = if rest == [], do: close_writer(outbox), else: outbox
      _ = Segment.delete(segment)
      trim(%{outbox | segments: rest})
    else
      outbox
    end
  end

  defp trim(outbox), do: outbox

  @doc "Syncs what was written to the disk."
  @spec sync(t()) :: t()
  def sync(%{unsynced: true, writer: writer} = outbox) when writer != nil do
    _ = :file.datasync(writer)
    %{outbox | unsynced: false}
  end

  def sync(outbox), do: outbox

  @doc "Closes the files."
  @spec close(t()) :: :ok
  def close(outbox) do
    _ = outbox |> sync() |> close_writer()
    :ok
  end

  @doc """
  `events`: not acknowledged; `bytes`, `segments`: on disk; `dropped`: since it was opened, because it was full or unreadable;
  `damaged`: segments with an unreadable end.
  """
  @spec stats(t()) :: %{
          events: non_neg_integer(),
          bytes: non_neg_integer(),
          segments: non_neg_integer(),
          dropped: non_neg_integer(),
          damaged: non_neg_integer()
        }
  def stats(outbox) do
    held =
      for segment <- outbox.segments,
          seq = max(segment.first, outbox.head),
          do: max(Segment.next(segment) - seq, 0)

    %{
      events: max(Enum.sum(held) - map_size(outbox.acked), 0),
      bytes: bytes(outbox),
      segments: length(outbox.segments),
      dropped: outbox.dropped,
      damaged: outbox.damaged
    }
  end

  @doc "Whether every record is acknowledged."
  @spec empty?(t()) :: boolean()
  def empty?(outbox), do: stats(outbox).events == 0

  defp bytes(outbox), do: outbox.segments |> Enum.map(&(&1.bytes + &1.waste)) |> Enum.sum()

  defp read_head(outbox) do
    case File.read(head_file(outbox)) do
      {:ok, <<seq::64, crc::32>>} -> if :erlang.crc32(<<seq::64>>) == crc, do: seq
      _ -> nil
    end
  end

  # Renamed into place, so that it is never half written.
  defp write_head(outbox) do
    new = head_file(outbox) <> ".new"

    with :ok <- File.write(new, <<outbox.head::64, :erlang.crc32(<<outbox.head::64>>)::32>>) do
      File.rename(new, head_file(outbox))
    end
  end

  defp head_file(outbox), do: Path.join(outbox.dir, "head")
end
