defmodule MavCodec.Msp.Parser do
  @max_payload 8_192

  @moduledoc """
  Finds frames of MSP in a stream of bytes: a value, without a process or a clock.

      {frames, parser} = MavCodec.Msp.Parser.push(MavCodec.Msp.Parser.new(), bytes)

  The result is the same however the bytes are cut. Behind what only looked like a frame the search goes on with the next byte.
  A payload has at most #{@max_payload} bytes, more than any firmware sends. The work for each byte is bounded, whatever the bytes
  are.

  Half a frame waits for its rest for ever. If the rest does not come, the caller says so (`expire/1`). `pending/1` is
  what waits: a flight controller's command line echoes a request as `$M<` or `$X<` and no more.
  """

  import Bitwise

  alias MavCodec.CRC.DvbS2
  alias MavCodec.Msp.Frame

  defstruct buffer: "",
            sums: <<0, 0>>,
            counters: %{frames: 0, skipped: 0, checksum: 0, oversize: 0, expired: 0}

  @typedoc """
  - `frames`: found
  - `skipped`: bytes outside of them
  - `checksum`: frames with a wrong checksum, `oversize`: with a larger payload than allowed
  - `expired`: halves that were given up
  """
  @type counters :: %{
          frames: non_neg_integer,
          skipped: non_neg_integer,
          checksum: non_neg_integer,
          oversize: non_neg_integer,
          expired: non_neg_integer
        }

  @typedoc """
  `sums`: XOR and CRC-8 up to each byte of the buffer, so that the check of any part of it takes the same time. Without
  them bytes that look like many long frames would be summed up again for each.
  """
  @type t :: %__MODULE__{buffer: binary, sums: binary, counters: counters}

  @doc "A parser that has read nothing."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "The frames that `bytes` complete, in their order."
  @spec push(t, binary) :: {[Frame.t()], t}
  def push(%__MODULE__{buffer: buffer, sums: sums} = parser, bytes) do
    scan(%{parser | buffer: buffer <> bytes, sums: sum_up(bytes, sums)}, 0, [])
  end

  @doc "Gives up the frame whose rest did not come, and returns those that began inside it."
  @spec expire(t) :: {[Frame.t()], t}
  def expire(%__MODULE__{buffer: ""} = parser), do: {[], parser}

  def expire(%__MODULE__{} = parser) do
    parser |> count(:expired, 1) |> count(:skipped, 1) |> scan(1, [])
  end

  @doc "The bytes that may be the beginning of a frame."
  @spec pending(t) :: binary
  def pending(%__MODULE__{buffer: buffer}), do: buffer

  @doc "What was counted since the beginning."
  @spec counters(t) :: counters
  def counters(%__MODULE__{counters: counters}), do: counters

  defp scan(%{buffer: buffer} = parser, at, frames) do
    case :binary.match(buffer, "$", scope: {at, byte_size(buffer) - at}) do
      {start, 1} -> candidate(count(parser, :skipped, start - at), start, frames)
      :nomatch -> finish(count(parser, :skipped, byte_size(buffer) - at), byte_size(buffer), frames)
    end
  end

  defp candidate(%{buffer: buffer, sums: sums} = parser, start, frames) do
    <<_::binary-size(^start), rest::binary>> = buffer

    case head(rest) do
      {:frame, _head, _skip, size, _checks} when size > @max_payload ->
        next(count(parser, :oversize, 1), start, frames)

      {:frame, head, skip, size, checks} when byte_size(rest) >= skip + size + checks ->
        payload = binary_part(rest, skip, size)
        sent = binary_part(rest, skip + size, checks)

        if sent == checks(head, sums, start, skip, size) do
          frame = frame(head, :binary.copy(payload))
          scan(count(parser, :frames, 1), start + skip + size + checks, [frame | frames])
        else
          next(count(parser, :checksum, 1), start, frames)
        end

      :none ->
        next(parser, start, frames)

      _incomplete ->
        finish(parser, start, frames)
    end
  end

  defp next(parser, start, frames), do: scan(count(parser, :skipped, 1), start + 1, frames)

  defp finish(%{buffer: buffer, sums: sums} = parser, at, frames) do
    rest = :binary.copy(binary_part(buffer, at, byte_size(buffer) - at))
    {Enum.reverse(frames), %{parser | buffer: rest, sums: drop_sums(sums, at)}}
  end

  defp sum_up(bytes, sums),
    do: sum_up(bytes, sums, :binary.at(sums, byte_size(sums) - 2), :binary.last(sums))

  defp sum_up(<<byte, rest::binary>>, sums, xor, crc) do
    xor = bxor(xor, byte)
    crc = DvbS2.next(crc, byte)
    sum_up(rest, <<sums::binary, xor, crc>>, xor, crc)
  end

  defp sum_up(<<>>, sums, _xor, _crc), do: sums

  defp drop_sums(sums, 0), do: sums
  defp drop_sums(sums, count), do: :binary.copy(binary_part(sums, 2 * count, byte_size(sums) - 2 * count))

  # The sums of the bytes from `from` to before `to`.
  defp xor(sums, from, to), do: bxor(:binary.at(sums, 2 * from), :binary.at(sums, 2 * to))

  defp crc(sums, from, to) do
    before = :binary.at(sums, 2 * from + 1)
    bxor(:binary.at(sums, 2 * to + 1), DvbS2.zeros(before, to - from))
  end

  # {:frame, what the header says, bytes before the payload, size of the payload, bytes of checksums}
  defguardp direction?(letter) when letter in ~c"<>!"

  defp head(<<"$X", letter, flags, id::16-little, size::16-little, _::binary>>) when direction?(letter),
    do: {:frame, {:v2, letter, id, flags}, 8, size, 1}

  defp head(<<"$X", letter, rest::binary>>) when direction?(letter) and byte_size(rest) < 5, do: :incomplete

  defp head(<<"$M", letter, 255, 255, flags, id::16-little, size::16-little, outer::16-little, _::binary>>)
       when direction?(letter) do
    if outer == size + 6 and outer >= 255,
      do: {:frame, {:v2_over_v1, letter, id, flags}, 12, size, 2},
      else: :none
  end

  defp head(<<"$M", letter, 255, 255, rest::binary>>) when direction?(letter) and byte_size(rest) < 7,
    do: :incomplete

  defp head(<<"$M", letter, outer, 255, flags, id::16-little, size::16-little, _::binary>>)
       when direction?(letter) do
    if outer == size + 6, do: {:frame, {:v2_over_v1, letter, id, flags}, 10, size, 2}, else: :none
  end

  defp head(<<"$M", letter, outer, 255, rest::binary>>) when direction?(letter) and byte_size(rest) < 5,
    do: if(outer < 6, do: :none, else: :incomplete)

  defp head(<<"$M", letter, 255, id, size::16-little, _::binary>>) when direction?(letter),
    do: if(size >= 255, do: {:frame, {:v1, letter, id, 0}, 7, size, 1}, else: :none)

  defp head(<<"$M", letter, 255, _id, rest::binary>>) when direction?(letter) and byte_size(rest) < 2,
    do: :incomplete

  defp head(<<"$M", letter, size, id, _::binary>>) when direction?(letter) and id != 255,
    do: {:frame, {:v1, letter, id, 0}, 5, size, 1}

  defp head(<<"$M", letter, rest::binary>>) when direction?(letter) and byte_size(rest) < 2, do: :incomplete
  defp head(start) when start in ["$", "$M", "$X"], do: :incomplete
  defp head(_other), do: :none

  defp checks({:v1, _, _, _}, sums, start, skip, size),
    do: <<xor(sums, start + 3, start + skip + size)>>

  defp checks({:v2, _, _, _}, sums, start, skip, size),
    do: <<crc(sums, start + 3, start + skip + size)>>

  # The CRC leaves out the size of a jumbo frame, which stands between the inner header and the payload.
  defp checks({:v2_over_v1, _, _, _}, sums, start, skip, size) do
    payload = start + skip
    header = crc(sums, start + 5, start + 10)
    crc = bxor(DvbS2.zeros(header, size), crc(sums, payload, payload + size))
    <<crc, bxor(xor(sums, start + 3, payload + size), crc)>>
  end

  defp frame({form, letter, id, flags}, payload),
    do: %Frame{form: form, direction: direction(letter), id: id, flags: flags, payload: payload}

  defp direction(?<), do: :request
  defp direction(?>), do: :reply
  defp direction(?!), do: :error

  defp count(parser, _name, 0), do: parser

  defp count(%{counters: counters} = parser, name, n),
    do: %{parser | counters: Map.update!(counters, name, &(&1 + n))}
end
