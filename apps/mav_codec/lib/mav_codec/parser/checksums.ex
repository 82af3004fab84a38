defmodule MavCodec.Parser.Checksums do
  @moduledoc """
  Computes the CRC of any range of some bytes in constant time, so that a search costs the same for any bytes.

  A byte that looks like a magic claims a frame of up to 280 bytes, and the next byte may claim one as well: with a CRC for
  each, a hostile byte would cost 280 CRC steps. The CRC is linear, so the register behind a range follows from its length
  and from the registers before and behind it in *one* run over all the bytes:

      crc(from, to) = register(to) xor advance(register(from) xor 0xFFFF, to - from)

  where `advance` is the effect of that many zero bytes, a few table look-ups. A window of registers is computed only when
  CRCs one by one have cost more than twice the bytes that were read, which never happens on a damaged line.
  """

  import Bitwise

  # CRCs one by one may cost this many bytes, plus twice what was read.
  @allowance 1024
  # The number of places in a window, and the longest range from one of them (17 bytes of header, 255 of payload).
  @window 2048
  @longest 272

  # By length: the effect of so many zero bytes on each part of the register (6, 5 and 5 bits, at 0, 64 and 96).
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

  # The effect of a byte on the register, and its effect one byte later.
  @step List.to_tuple(for byte <- 0..255, do: bits.(byte))
  @steps List.to_tuple(for byte <- 0..255, do: byte |> bits.() |> bits.())

  @typedoc """
  `spent` - bytes that CRCs one by one have cost; `registers` - of a run from behind the byte `from` to behind the byte `to`,
  see `register/2`.
  """
  @type t :: {spent :: non_neg_integer(), from :: non_neg_integer(), to :: integer(), registers :: tuple()}

  @doc "Nothing spent and no window."
  @spec new() :: t()
  def new, do: {0, 0, -1, {}}

  @doc "A CRC of `size` bytes was computed elsewhere."
  @spec spent(t(), non_neg_integer()) :: t()
  def spent({spent, from, to, registers}, size), do: {spent + size, from, to, registers}

  @doc """
  Whether the CRC of the `size` bytes behind the byte `from` may be computed by itself, or else a window that contains them.
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

  # Two bytes a step, so that the processor waits for a register half as often; eight registers in one tuple, which takes
  # half the memory of a list. The guard lets the compiler leave out checks of each number.
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

  @doc "The register behind so many bytes of a window."
  defmacro register(registers, place) do
    quote do
      place = unquote(place)
      elem(elem(unquote(registers), Bitwise.bsr(place, 3)), Bitwise.band(place, 7))
    end
  end

  @doc """
  The CRC of a frame whose `size` bytes of header and payload are between the registers `before` and `behind` of a window.

  A macro, because a call would make the search, which may need this for each byte, save all its registers.
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
