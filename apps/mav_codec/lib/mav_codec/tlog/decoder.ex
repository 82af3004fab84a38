defmodule MavCodec.Tlog.Decoder do
  @moduledoc """
  Turns the bytes of a tlog into frames, in any chunking: the pure part of `MavCodec.Tlog.Reader`.

  A record is 8 bytes of time and a frame with a known id and a correct CRC. A frame with an unknown id is accepted if a record
  (time, magic) or the end of the data follows it. Anything else is damage: the search continues at the next byte, and the
  skipped bytes are reported as one `MavCodec.Tlog.Damage` before the next frame.

  What is written before a frame is not always a time: the recorder may have no clock yet (its time begins in 1970), the
  clock is set meanwhile, or the bytes are damaged.

    * From 2000 to 2100 it is a time, and so is what is at most a day from the time before.
    * A recorder whose clock went back to 1970 still tells how much later a record is: time goes on by that.
    * Anything else is damaged, and the record gets the time of the one before. Records after 2100 before the first possible
      time are skipped, and so are all of a file whose times are in nanoseconds.

  A file that begins with frames without times is a raw log: one `MavCodec.Tlog.Damage` of the kind `:raw` stands for all of it.
  """

  alias MavCodec.{Frame, Tlog}
  alias MavCodec.Parser.{Candidate, Known}

  @year_2000 946_684_800_000_000
  @year_2100 4_102_444_800_000_000
  @day 86_400_000_000
  # The end of a raw log's frame can look like a time. After this many records a file is known to have times.
  @undecided 16

  @enforce_keys [:known, :accepted]
  defstruct @enforce_keys ++
              [held: <<>>, offset: 0, skipped: 0, taken: 0, stamp: nil, untimed: false, raw: false]

  @type t :: %__MODULE__{
          known: Known.t(),
          accepted: 0..255,
          held: binary(),
          offset: non_neg_integer(),
          skipped: non_neg_integer(),
          taken: non_neg_integer(),
          stamp: {time :: non_neg_integer(), written :: non_neg_integer()} | nil,
          untimed: boolean(),
          raw: boolean()
        }
  @type item :: Frame.t() | Tlog.Damage.t()

  @doc "A decoder at the start of a file; options as `MavCodec.Parser.new/1`, but long system ids are accepted."
  @spec new([MavCodec.Parser.option()]) :: t()
  def new(options \\ []) do
    options = Keyword.validate!(options, dialects: [MavCodec.Dialects.All], sysid32: true)
    %__MODULE__{known: Known.new(options[:dialects]), accepted: Candidate.accepted_flags(options[:sysid32])}
  end

  @doc "The frames and damage that the next bytes of the file complete."
  @spec push(t(), binary()) :: {[item()], t()}
  def push(%__MODULE__{raw: true} = decoder, _data), do: {[], decoder}

  def push(%__MODULE__{held: held} = decoder, data) do
    {items, rest, decoder} = records(held <> data, [], decoder, :stream)
    {Enum.reverse(items), %{decoder | held: :binary.copy(rest)}}
  end

  @doc "The end of the file: the remaining frames and damage."
  @spec finish(t()) :: [item()]
  def finish(%__MODULE__{held: held} = decoder) do
    {items, <<>>, decoder} = records(held, [], decoder, :final)
    if decoder.raw, do: items, else: Enum.reverse(damage(items, decoder, :cut_off))
  end

  defp records(<<at::64, frame::binary>> = data, items, decoder, mode) do
    case Candidate.classify(frame, decoder.known, decoder.accepted) do
      {:good, size, extra} -> take(at, frame, size, extra, items, decoder, mode)
      {:unknown, size} -> unknown(data, at, frame, size, items, decoder, mode)
      :more when mode == :stream -> {items, data, decoder}
      _no_record -> no_record(data, items, decoder, mode)
    end
  end

  defp records(<<>>, items, decoder, _mode), do: {items, <<>>, decoder}
  defp records(data, items, decoder, :stream), do: {items, data, decoder}
  defp records(data, items, decoder, :final), do: skip(data, items, decoder, :final)

  defp unknown(data, at, frame, size, items, decoder, mode) do
    case frame do
      <<_::binary-size(^size), time::64, magic, _::binary>>
      when magic in [0xFD, 0xFE] and abs(time - at) < @day ->
        take(at, frame, size, nil, items, decoder, mode)

      <<_::binary-size(^size), _::64, _, _::binary>> ->
        skip(data, items, decoder, mode)

      _ when mode == :stream ->
        {items, data, decoder}

      <<_::binary-size(^size)>> ->
        take(at, frame, size, nil, items, decoder, mode)

      _ends_elsewhere ->
        skip(data, items, decoder, mode)
    end
  end

  defp take(at, data, size, extra, items, decoder, mode) do
    <<bytes::binary-size(^size), rest::binary>> = data

    case time(decoder.stamp, at) do
      nil ->
        records(rest, items, %{decoder | skipped: decoder.skipped + 8 + size, untimed: true}, mode)

      time ->
        items = damage(items, decoder, :damaged)
        frame = Frame.from_bytes(bytes, extra, time)
        records(rest, [frame | items], taken(decoder, {time, at}, 8 + size), mode)
    end
  end

  # The time of a record, by what is written and by the record before.
  defp time(nil, at), do: if(at <= @year_2100, do: at)
  defp time(_before, at) when at in @year_2000..@year_2100, do: at
  defp time({time, _written}, at) when abs(at - time) <= @day, do: at

  defp time({time, written}, at) when at < @year_2000 and written < @year_2000 and abs(at - written) <= @day,
    do: max(time + at - written, 0)

  defp time({time, _written}, _damaged), do: time

  defp taken(decoder, stamp, size) do
    offset = decoder.offset + decoder.skipped + size
    %{decoder | offset: offset, skipped: 0, untimed: false, stamp: stamp, taken: decoder.taken + 1}
  end

  defp no_record(data, items, %{taken: taken} = decoder, mode) when taken < @undecided do
    case raw(data, decoder, mode) do
      true -> {[%Tlog.Damage{kind: :raw, offset: 0, bytes: byte_size(data)}], <<>>, %{decoder | raw: true}}
      false -> skip(data, items, decoder, mode)
      :more -> {items, data, decoder}
    end
  end

  defp no_record(data, items, decoder, mode), do: skip(data, items, decoder, mode)

  # Two frames in succession, without a time before either.
  defp raw(data, decoder, mode) do
    with {:good, size, _extra} <- Candidate.classify(data, decoder.known, decoder.accepted),
         <<_::binary-size(^size), next::binary>> = data,
         {:good, _size, _extra} <- Candidate.classify(next, decoder.known, decoder.accepted) do
      true
    else
      :more when mode == :stream -> :more
      _no_frame -> false
    end
  end

  defp skip(<<_, rest::binary>>, items, decoder, mode),
    do: records(rest, items, %{decoder | skipped: decoder.skipped + 1}, mode)

  defp damage(items, %{skipped: 0}, _kind), do: items

  defp damage(items, %{untimed: true} = decoder, _kind),
    do: damage(items, %{decoder | untimed: false}, :untimed)

  defp damage(items, decoder, kind),
    do: [%Tlog.Damage{kind: kind, offset: decoder.offset, bytes: decoder.skipped} | items]
end
