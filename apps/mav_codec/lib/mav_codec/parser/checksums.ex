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

  # The bytes that CRCs one by one may cost: this many, and twice what was read.
  @allowance 1024
  # The places of a window, and the longest stretch that begins at one (17 bytes of header, 255 of payload).
  @window 2048
  @longest 272

  # By length, what so many zero bytes make of each of the register's parts of 6, 5 and 5 bits, at 0, 64 and 96.
  bits = fn crc ->
    x = crc &&& 0xFF
    x = bxor(x, x <<< 4) &&& 0xFF
    (crc >>> 8) |> bxor(x <<< 8) |> bxor(x <<< 3) |> bxor(x >>> 4)
  end

  none = for {bits, at} <- [{6, 0}, {5, 6}, {5, 11}], value <- 0..((1 <<< bits) - 1), do: value <<< at

  @advance none
           |> Stream.iterate(fn registers -> Enum.map(registers, bits) end)
           |> Enum.take(@longest + 1)
           |> Enum.map(&List.to_tuple/1)
           |> List.to_tuple()

  # What a byte makes of the register, and what it does one byte later.
  @step List.to_tuple(for byte <- 0..255, do: bits.(byte))
  @steps List.to_tuple(for byte <- 0..255, do: byte |> bits.() |> bits.())

  @typedoc """
  `spent` - bytes that CRCs one by one have cost; `registers` - of the run that begins behind the byte `from`, up to that
  behind the byte `to`, see `register/2`.
  """
  @type t :: {spent :: non_neg_integer(), from :: non_neg_integer(), to :: integer(), registers :: tuple()}

  @doc "Nothing spent and no window."
  @spec new() :: t()
  def new, do: {0, 0, -1, {}}

  @doc "A CRC of `size` bytes was computed elsewhere."
  @spec spent(t(), non_neg_integer()) :: t()
  def spent({spent, from, to, registers}, size), do: {spent + size, from, to, registers}

  @doc """
  For the `size` bytes behind the byte `from`: whether their CRC may be computed by itself, or else a window in which they
  lie.
  """
  @spec reach(t(), binary(), non_neg_integer(), non_neg_integer()) :: {:direct | :window, t()}
  def reach({spent, first, last, registers}, _data, from, size) when spent + size <= @allowance + 2 * from,
    do: {:direct, {spent + size, first, last, registers}}

  def reach({_spent, first, last, _registers} = sums, _data, from, size)
      when from >= first and from + size <= last,
      do: {:window, sums}

  def reach({spent, _first, _last, _registers}, data, from, _size) do
    count = min(byte_size(data) - from - 1, @window + @longest)
    <<_::binary-size(^from), _magic, bytes::binary-size(^count), _::binary>> = data
    {:window, {spent, from, from + count, List.to_tuple(run(bytes, 0, []))}}
  end

  # Two bytes a step, so that the processor waits half as often for a register; eight registers in one tuple, which is half
  # of the memory that a list would take. The guard lets the compiler leave out checks of each number.
  defp run(<<a::16-little, b::16-little, c::16-little, d::16-little, rest::binary>>, r0, registers)
       when is_integer(r0) and r0 in 0..0xFFFF do
    x = bxor(r0, a)
    r1 = bxor(r0 >>> 8, elem(@step, x &&& 0xFF))
    r2 = bxor(elem(@steps, x &&& 0xFF), elem(@step, x >>> 8))
    x = bxor(r2, b)
    r3 = bxor(r2 >>> 8, elem(@step, x &&& 0xFF))
    r4 = bxor(elem(@steps, x &&& 0xFF), elem(@step, x >>> 8 &&& 0xFF))
    x = bxor(r4, c)
    r5 = bxor(r4 >>> 8, elem(@step, x &&& 0xFF))
    r6 = bxor(elem(@steps, x &&& 0xFF), elem(@step, x >>> 8 &&& 0xFF))
    x = bxor(r6, d)
    r7 = bxor(r6 >>> 8, elem(@step, x &&& 0xFF))
    r8 = bxor(elem(@steps, x &&& 0xFF), elem(@step, x >>> 8 &&& 0xFF))
    run(rest, r8, [{r0, r1, r2, r3, r4, r5, r6, r7} | registers])
  end

  defp run(rest, register, registers) do
    step = fn byte, register -> bxor(register >>> 8, elem(@step, bxor(register &&& 0xFF, byte))) end
    last = rest |> :binary.bin_to_list() |> Enum.scan(register, step)
    Enum.reverse(registers, [List.to_tuple([register | last])])
  end

  @doc "The register of a window behind so many bytes."
  defmacro register(registers, place) do
    quote do
      place = unquote(place)
      elem(elem(unquote(registers), Bitwise.bsr(place, 3)), Bitwise.band(place, 7))
    end
  end

  @doc """
  The CRC of a frame whose `size` bytes of header and payload stand between the registers `before` and `behind` of a window.

  A macro: a call would make the search, which calls this for each byte of some data, put aside all that it holds.
  """
  defmacro frame(before, behind, size, crc_extra) do
    quote do
      zeros = elem(unquote(Macro.escape(@advance)), unquote(size))
      from = Bitwise.bxor(unquote(before), 0xFFFF)

      crc =
        unquote(behind)
        |> Bitwise.bxor(elem(zeros, Bitwise.band(from, 0x3F)))
        |> Bitwise.bxor(elem(zeros, 64 + Bitwise.band(Bitwise.bsr(from, 6), 0x1F)))
        |> Bitwise.bxor(elem(zeros, 96 + Bitwise.band(Bitwise.bsr(from, 11), 0x1F)))

      Bitwise.bxor(
        Bitwise.bsr(crc, 8),
        elem(unquote(Macro.escape(@step)), Bitwise.bxor(Bitwise.band(crc, 0xFF), unquote(crc_extra)))
      )
    end
  end
end
