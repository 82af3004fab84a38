defmodule MavCodec.Parser.Checksums do
  @moduledoc """
  The CRC of any stretch of some bytes, so that a search costs the same whatever the bytes are.

  A byte that looks like a magic claims a frame of up to 280 bytes, and the next byte may claim one as well: with a CRC for
  each, hostile bytes would cost 280 times what they are. The CRC is linear, so the register behind a stretch follows from
  the registers before and behind it of *one* run over all the bytes, and from the stretch's length:

      crc(from, to) = register(to) xor advance(register(from) xor 0xFFFF, to - from)

  where `advance` is what that many zero bytes do, a few looks into a table. A window of the bytes' registers is made only
  when CRCs computed one by one have cost more than twice the bytes that were read, which damage on a line never does.
  """

  import Bitwise

  alias MavCodec.CRC

  # The bytes that CRCs one by one may cost: this many, and twice what was read.
  @allowance 1024
  # The places of a window, and the longest stretch that begins at one (17 bytes of header, 255 of payload).
  @window 2048
  @longest 272

  # By length, what so many zero bytes make of each of the register's four nibbles, at 16 * nibble + value.
  bits = fn crc ->
    x = crc &&& 0xFF
    x = bxor(x, x <<< 4) &&& 0xFF
    (crc >>> 8) |> bxor(x <<< 8) |> bxor(x <<< 3) |> bxor(x >>> 4)
  end

  none = for nibble <- 0..3, value <- 0..15, do: value <<< (4 * nibble)

  @advance none
           |> Stream.iterate(fn registers -> Enum.map(registers, bits) end)
           |> Enum.take(@longest + 1)
           |> Enum.map(&List.to_tuple/1)
           |> List.to_tuple()

  @step List.to_tuple(for byte <- 0..255, do: bits.(byte))

  @typedoc """
  `spent` - bytes that CRCs one by one have cost; `registers` - of the run that begins behind the byte `from`, the first is
  that behind `from`, the last that behind `to`.
  """
  @type t :: {spent :: non_neg_integer(), from :: non_neg_integer(), to :: integer(), registers :: tuple()}

  @doc "Nothing spent and no window."
  @spec new() :: t()
  def new, do: {0, 0, -1, {}}

  @doc "A CRC of `size` bytes was computed elsewhere."
  @spec spent(t(), non_neg_integer()) :: t()
  def spent({spent, from, to, registers}, size), do: {spent + size, from, to, registers}

  @doc """
  For the `size` bytes behind the byte `from`, which do not lie in the window: whether their CRC may be computed by itself,
  or else a new window.
  """
  @spec reach(t(), binary(), non_neg_integer(), non_neg_integer()) :: {:direct | :window, t()}
  def reach({spent, first, last, registers}, _data, from, size) when spent + size <= @allowance + 2 * from,
    do: {:direct, {spent + size, first, last, registers}}

  def reach({spent, _first, _last, _registers}, data, from, _size) do
    count = min(byte_size(data) - from - 1, @window + @longest)
    <<_::binary-size(^from), _magic, bytes::binary-size(^count), _::binary>> = data
    {:window, {spent, from, from + count, List.to_tuple(run(bytes, 0))}}
  end

  defp run(<<byte, rest::binary>>, register),
    do: [register | run(rest, bxor(register >>> 8, elem(@step, bxor(register &&& 0xFF, byte))))]

  defp run(<<>>, register), do: [register]

  @doc "The CRC of the `size` bytes between the registers `before` and `behind` of a window."
  @spec behind(CRC.crc16(), CRC.crc16(), 0..272) :: CRC.crc16()
  def behind(before, behind, size) do
    zeros = elem(@advance, size)
    from = bxor(before, 0xFFFF)

    behind
    |> bxor(elem(zeros, from &&& 0xF))
    |> bxor(elem(zeros, 16 + (from >>> 4 &&& 0xF)))
    |> bxor(elem(zeros, 32 + (from >>> 8 &&& 0xF)))
    |> bxor(elem(zeros, 48 + (from >>> 12)))
  end

  @doc "Whether `crc` is that of a frame whose bytes have the CRC `behind`, with this CRC_EXTRA or one of these."
  @spec ends?(CRC.crc16(), byte() | [byte()], CRC.crc16()) :: boolean()
  def ends?(behind, extra, crc) when is_integer(extra),
    do: bxor(behind >>> 8, elem(@step, bxor(behind &&& 0xFF, extra))) == crc

  def ends?(behind, extras, crc), do: Enum.any?(extras, &ends?(behind, &1, crc))
end
