defmodule MavCodec.Parser do
  @moduledoc """
  Turns the bytes of a link into frames: a pure value, any chunking, MAVLink 1 and 2 interleaved (F1-F13).

      parser = MavCodec.Parser.new()
      {frames, parser} = MavCodec.Parser.push(parser, bytes, System.os_time(:microsecond))

  `push/3` is for streams (serial, TCP), `reduce/5` for whole files: the frames do not depend on how the bytes are cut into
  pieces. Frames of unknown ids, whose CRC cannot be checked, wait for the byte after them; `flush/1` ends the waiting when
  the line is quiet or closed. `push_datagram/3` is for UDP: it uses the datagram's boundary.

  No bytes make it raise, and what it keeps is bounded: fewer than `max_held/0` bytes and the counters of
  `MavCodec.Parser.Sources.limit/0` sources. The rules are those of `MavCodec.Parser.Scanner`.
  """

  alias MavCodec.Frame
  alias MavCodec.Parser.{Candidate, Known, Scanner, Sources}

  # An unknown frame of 300 bytes whose last byte may begin a known one of 300.
  @max_held 600

  # All frames of a file that is pushed at once stay alive. On a growing heap they would be copied again and again, which
  # costs four times as much time and memory as reading the file. So the heap is sized first, by the usual size of the frames.
  @large 256 * 1024
  @words 2
  @most_words 32 * 1024 * 1024

  # `reduce/5` reads this much at a time, so that its frames are garbage before the next collection.
  @piece 2 * 1024

  @enforce_keys [:scanner]
  defstruct [
    :scanner,
    held: <<>>,
    at: nil,
    sources: Sources.new(),
    bytes: 0,
    frames: 0,
    signed: 0,
    unknown: 0
  ]

  @opaque t :: %__MODULE__{
            scanner: Scanner.t(),
            held: binary(),
            at: integer() | nil,
            sources: Sources.t(),
            bytes: non_neg_integer(),
            frames: non_neg_integer(),
            signed: non_neg_integer(),
            unknown: non_neg_integer()
          }

  @typedoc """
    * `:dialects` - modules of the behaviour `MavCodec.Dialect` whose CRC_EXTRA values are tried; default
      `[MavCodec.Dialects.All]`
    * `:sysid32` - accept MAVLink 2.1's 32-bit system ids (N1-N3); default `false`, such frames are then dropped and
      counted as incompatible
  """
  @type option :: {:dialects, [module()]} | {:sysid32, boolean()}

  @typedoc """
    * `frames` - returned, including those of unknown ids
    * `bytes` - pushed
    * `held` - kept for the next push
    * `crc_errors` - complete frames of known ids with a wrong CRC (including noise that looks like one)
    * `resync_bytes` - bytes outside frames
    * `unknown_ids` - frames returned unchecked
    * `incompatible` - intact frames dropped for their incompatibility flags (F6)
    * `signed` - frames with a signature
    * `lost` - by sequence numbers, of the sources whose loss can be estimated
    * `sources` - by `{system, component}`, see `MavCodec.Parser.Sources.stats/1`
  """
  @type stats :: %{
          frames: non_neg_integer(),
          bytes: non_neg_integer(),
          held: non_neg_integer(),
          crc_errors: non_neg_integer(),
          resync_bytes: non_neg_integer(),
          unknown_ids: non_neg_integer(),
          incompatible: non_neg_integer(),
          signed: non_neg_integer(),
          lost: non_neg_integer(),
          sources: map()
        }

  @doc "A parser that has read nothing."
  @spec new([option()]) :: t()
  def new(options \\ []) do
    options = Keyword.validate!(options, dialects: [MavCodec.Dialects.All], sysid32: false)

    known = Known.new(options[:dialects])
    %__MODULE__{scanner: Scanner.new(known, Candidate.accepted_flags(options[:sysid32]))}
  end

  @doc "The most bytes that a parser keeps between two pushes."
  @spec max_held() :: pos_integer()
  def max_held, do: @max_held

  @doc """
  Reads bytes of a stream that arrived `at` (unix microseconds, or `nil`).

  A frame has the time of the push that completed it.
  """
  @spec push(t(), binary(), integer() | nil) :: {[Frame.t()], t()}
  def push(parser, data, at \\ nil)
  def push(%__MODULE__{held: <<>>} = parser, data, at), do: read(parser, data, byte_size(data), at, :stream)

  def push(%__MODULE__{held: held} = parser, data, at),
    do: read(parser, held <> data, byte_size(data), at, :stream)

  @doc """
  Reads bytes of a stream and reduces its frames with `fun`: for files, because `push/3` would have to keep all frames at
  once.

      {count, parser} = MavCodec.Parser.reduce(MavCodec.Parser.new(), File.read!("flight.raw"), 0, fn _frame, n -> n + 1 end)

  Frames that `fun` keeps keep `data` alive.
  """
  @spec reduce(t(), binary(), acc, (Frame.t(), acc -> acc), integer() | nil) :: {acc, t()} when acc: term()
  def reduce(parser, data, acc, fun, at \\ nil)

  def reduce(parser, <<piece::binary-size(@piece), rest::binary>>, acc, fun, at) do
    {frames, parser} = push(parser, piece, at)
    reduce(parser, rest, Enum.reduce(frames, acc, fun), fun, at)
  end

  def reduce(parser, data, acc, fun, at) do
    {frames, parser} = push(parser, data, at)
    {Enum.reduce(frames, acc, fun), parser}
  end

  @doc """
  Reads one datagram.

  A frame may be split over datagrams. But if the datagram begins with an intact frame, the bytes kept of the previous one
  are given up, so that a bad datagram costs only itself. A frame of an unknown id may end with the datagram.
  """
  @spec push_datagram(t(), binary(), integer() | nil) :: {[Frame.t()], t()}
  def push_datagram(parser, data, at \\ nil)

  def push_datagram(%__MODULE__{held: <<>>, scanner: scanner} = parser, data, at),
    do: read(%{parser | scanner: Scanner.boundary(scanner)}, data, byte_size(data), at, :datagram)

  def push_datagram(%__MODULE__{held: held, scanner: scanner} = parser, data, at) do
    case Candidate.classify(data, scanner.known, scanner.accepted) do
      {:good, _size, _extra} ->
        {before, parser} = flush(parser)
        {frames, parser} = read(parser, data, byte_size(data), at, :datagram)
        {before ++ frames, parser}

      _not_a_beginning ->
        read(parser, held <> data, byte_size(data), at, :datagram)
    end
  end

  @doc "Counts frames that arrived `at` as frames, as if their bytes had been read, and gives them that time."
  @spec take(t(), [Frame.t()], integer() | nil) :: {[Frame.t()], t()}
  def take(%__MODULE__{} = parser, frames, at) do
    frames = for frame <- frames, do: %{frame | at: at}
    bytes = for %{bytes: bytes} <- frames, reduce: parser.bytes, do: (sum -> sum + byte_size(bytes))
    sources = Sources.observe(parser.sources, frames)
    {frames, %{parser | sources: sources, bytes: bytes, frames: parser.frames + length(frames)}}
  end

  @doc """
  Ends the waiting, because no bytes follow for now: returns waiting frames of unknown ids and gives up the rest. They have
  the time of the push that brought them.
  """
  @spec flush(t()) :: {[Frame.t()], t()}
  def flush(%__MODULE__{held: <<>>} = parser), do: {[], parser}
  def flush(%__MODULE__{held: held, at: at} = parser), do: read(parser, held, 0, at, :final)

  @doc "Whether it keeps bytes that may be the beginning of a frame."
  @spec waiting?(t()) :: boolean()
  def waiting?(%__MODULE__{held: held}), do: held != <<>>

  defp read(parser, data, new_bytes, at, mode) when byte_size(data) >= @large do
    before = Process.flag(:min_heap_size, min(byte_size(data) * @words, @most_words))
    _ = :erlang.garbage_collect()

    try do
      all(parser, data, new_bytes, at, mode)
    after
      Process.flag(:min_heap_size, before)
    end
  end

  defp read(parser, data, new_bytes, at, mode), do: all(parser, data, new_bytes, at, mode)

  defp all(parser, data, new_bytes, at, mode) do
    {found, held, scanner} = Scanner.scan(parser.scanner, data, at, mode)
    {frames, count, signed, unknown} = in_order(found, [], 0, 0, 0)

    parser = %{
      parser
      | scanner: scanner,
        held: own(held),
        at: at,
        sources: Sources.observe(parser.sources, frames),
        bytes: parser.bytes + new_bytes,
        frames: parser.frames + count,
        signed: parser.signed + signed,
        unknown: parser.unknown + unknown
    }

    {frames, parser}
  end

  defp in_order(
         [%Frame{crc_extra: nil, signature: signature} = frame | found],
         frames,
         count,
         signed,
         unknown
       ),
       do:
         in_order(
           found,
           [frame | frames],
           count + 1,
           if(signature, do: signed + 1, else: signed),
           unknown + 1
         )

  defp in_order([%Frame{signature: nil} = frame | found], frames, count, signed, unknown),
    do: in_order(found, [frame | frames], count + 1, signed, unknown)

  defp in_order([frame | found], frames, count, signed, unknown),
    do: in_order(found, [frame | frames], count + 1, signed + 1, unknown)

  defp in_order([], frames, count, signed, unknown), do: {frames, count, signed, unknown}

  # A copy, because a few kept bytes must not keep the whole read alive.
  defp own(<<>>), do: <<>>
  defp own(held), do: :binary.copy(held)

  @doc "The counters since the start."
  @spec stats(t()) :: stats()
  def stats(%__MODULE__{scanner: scanner} = parser) do
    sources = Sources.stats(parser.sources)

    %{
      frames: parser.frames,
      bytes: parser.bytes,
      held: byte_size(parser.held),
      crc_errors: scanner.crc_errors,
      resync_bytes: scanner.resync_bytes,
      unknown_ids: parser.unknown,
      incompatible: scanner.incompatible,
      signed: parser.signed,
      lost: Sources.lost(sources),
      sources: sources
    }
  end
end
