defmodule MavCodec.Tlog.Decoder do
  @moduledoc """
  Turns the bytes of a tlog into frames, in any chunking: the pure part of `MavCodec.Tlog.Reader`.

  A record is 8 bytes of time and a frame with a known id and a correct CRC. A frame with an unknown id is accepted if a record
  (time, magic) or the end of the data follows it. Anything else is damage: the search continues at the next byte, and the
  skipped bytes are reported as one `MavCodec.Tlog.Damage` before the next frame.

  An impossible time (before 2000 or after 2100, and more than a day from the previous one) is damaged: the frame gets the
  previous frame's time.
  """

  alias MavCodec.{Frame, Tlog}
  alias MavCodec.Parser.{Candidate, Known}

  @year_2000 946_684_800_000_000
  @year_2100 4_102_444_800_000_000
  @day 86_400_000_000

  @enforce_keys [:known, :accepted]
  defstruct @enforce_keys ++ [held: <<>>, offset: 0, skipped: 0, last: nil]

  @type t :: %__MODULE__{
          known: Known.t(),
          accepted: 0..255,
          held: binary(),
          offset: non_neg_integer(),
          skipped: non_neg_integer(),
          last: integer() | nil
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
  def push(%__MODULE__{held: held} = decoder, data) do
    {items, rest, decoder} = records(held <> data, [], decoder, :stream)
    {Enum.reverse(items), %{decoder | held: :binary.copy(rest)}}
  end

  @doc "The end of the file: the remaining frames and damage."
  @spec finish(t()) :: [item()]
  def finish(%__MODULE__{held: held} = decoder) do
    {items, <<>>, decoder} = records(held, [], decoder, :final)
    Enum.reverse(damage(items, decoder, :cut_off))
  end

  defp records(<<at::64, frame::binary>> = data, items, decoder, mode) do
    case Candidate.judge(frame, decoder.known, decoder.accepted) do
      {:good, size, extra} -> take(at, frame, size, extra, items, decoder, mode)
      {:unknown, size} -> unknown(data, at, frame, size, items, decoder, mode)
      :more when mode == :stream -> {items, data, decoder}
      _no_record -> skip(data, items, decoder, mode)
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
    items = damage(items, decoder, :damaged)
    at = time(at, decoder.last)
    decoder = %{decoder | offset: decoder.offset + decoder.skipped + 8 + size, skipped: 0, last: at}
    records(rest, [Frame.from_bytes(bytes, extra, at) | items], decoder, mode)
  end

  defp skip(<<_, rest::binary>>, items, decoder, mode),
    do: records(rest, items, %{decoder | skipped: decoder.skipped + 1}, mode)

  defp damage(items, %{skipped: 0}, _kind), do: items

  defp damage(items, decoder, kind),
    do: [%Tlog.Damage{kind: kind, offset: decoder.offset, bytes: decoder.skipped} | items]

  defp time(at, nil), do: at
  defp time(at, _last) when at in @year_2000..@year_2100, do: at
  defp time(at, last) when abs(at - last) <= @day, do: at
  defp time(_at, last), do: last
end
