defmodule MavCodec.CRC do
  @moduledoc """
  The two checksums of MAVLink.

    * `x25/2`, `frame/3`: CRC-16/MCRF4XX (the guide calls it X.25), at the end of every frame (F5).
    * `crc32/2`: the CRC-32 of MAVLink FTP and of the component metadata, which starts at 0 and has no final
      XOR (F15), unlike the one of zip and Ethernet.

  The 16-bit CRC is computed eight bytes at a time from eight tables of 256 entries (16 KB, so that they stay in the
  first-level cache; one table of 65,536 entries needs the same time on an idle core and more on a busy one).
  """

  import Bitwise

  # Moves the register over one byte of zeros; the n-th table is for n bytes.
  step = fn crc ->
    x = crc &&& 0xFF
    x = bxor(x, x <<< 4) &&& 0xFF
    (crc >>> 8) |> bxor(x <<< 8) |> bxor(x <<< 3) |> bxor(x >>> 4)
  end

  advance = fn crc, bytes -> Enum.reduce(1..bytes, crc, fn _, crc -> step.(crc) end) end

  # @t0 moves a byte over one byte of the message, @t7 over eight.
  @t0 List.to_tuple(for x <- 0..255, do: advance.(x, 1))
  @t1 List.to_tuple(for x <- 0..255, do: advance.(x, 2))
  @t2 List.to_tuple(for x <- 0..255, do: advance.(x, 3))
  @t3 List.to_tuple(for x <- 0..255, do: advance.(x, 4))
  @t4 List.to_tuple(for x <- 0..255, do: advance.(x, 5))
  @t5 List.to_tuple(for x <- 0..255, do: advance.(x, 6))
  @t6 List.to_tuple(for x <- 0..255, do: advance.(x, 7))
  @t7 List.to_tuple(for x <- 0..255, do: advance.(x, 8))

  @typedoc "A 16-bit register value, 0..0xFFFF."
  @type crc16 :: 0..0xFFFF

  @doc """
  The CRC-16/MCRF4XX of `data`, continued from `crc`.

      iex> MavCodec.CRC.x25("123456789")
      0x6F91
  """
  @spec x25(binary(), crc16()) :: crc16()
  def x25(data, crc \\ 0xFFFF)
  def x25(<<>>, crc), do: crc

  def x25(data, crc) do
    size = byte_size(data) - 1
    blocks(data, size, crc, :binary.at(data, size))
  end

  @doc """
  The CRC of a frame (F5): over the `size` bytes after its magic and then `crc_extra`.

  `frame` must hold at least `size + 1` bytes; bytes behind them are ignored.
  """
  @spec frame(binary(), non_neg_integer(), byte()) :: crc16()
  def frame(<<_magic, rest::binary>>, size, crc_extra), do: blocks(rest, size, 0xFFFF, crc_extra)

  # `size` bytes of the data and then the byte `last`. Bytes that do not depend on the register come first, so that the
  # processor need not wait for it. The last bytes are one jump to straight code, because a loop's branches would be
  # mispredicted. The head matches, so that one match context serves all blocks; no pipe into a function, since `then/2` would
  # cost a call and a binary per block.
  defp blocks(<<data::binary>>, size, crc, last) do
    case size do
      0 ->
        add(crc, last)

      1 ->
        <<a, _::binary>> = data
        bxor(elem(@t1, bxor(crc &&& 0xFF, a)), elem(@t0, bxor(crc >>> 8, last)))

      2 ->
        <<a::16-little, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t1, crc >>> 8))
        |> bxor(elem(@t2, crc &&& 0xFF))

      3 ->
        <<a::16-little, b2, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t1, b2))
        |> bxor(elem(@t2, crc >>> 8))
        |> bxor(elem(@t3, crc &&& 0xFF))

      4 ->
        <<a::16-little, b2, b3, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t2, b2))
        |> bxor(elem(@t1, b3))
        |> bxor(elem(@t3, crc >>> 8))
        |> bxor(elem(@t4, crc &&& 0xFF))

      5 ->
        <<a::16-little, b2, b3, b4, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t3, b2))
        |> bxor(elem(@t2, b3))
        |> bxor(elem(@t1, b4))
        |> bxor(elem(@t4, crc >>> 8))
        |> bxor(elem(@t5, crc &&& 0xFF))

      6 ->
        <<a::16-little, b2, b3, b4, b5, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t4, b2))
        |> bxor(elem(@t3, b3))
        |> bxor(elem(@t2, b4))
        |> bxor(elem(@t1, b5))
        |> bxor(elem(@t5, crc >>> 8))
        |> bxor(elem(@t6, crc &&& 0xFF))

      7 ->
        <<a::16-little, b2, b3, b4, b5, b6, _::binary>> = data
        crc = bxor(crc, a)

        elem(@t0, last)
        |> bxor(elem(@t5, b2))
        |> bxor(elem(@t4, b3))
        |> bxor(elem(@t3, b4))
        |> bxor(elem(@t2, b5))
        |> bxor(elem(@t1, b6))
        |> bxor(elem(@t6, crc >>> 8))
        |> bxor(elem(@t7, crc &&& 0xFF))

      _8_or_more ->
        <<a::16-little, b2, b3, b4, b5, b6, b7, rest::binary>> = data
        crc = bxor(crc, a)

        crc =
          elem(@t5, b2)
          |> bxor(elem(@t4, b3))
          |> bxor(elem(@t3, b4))
          |> bxor(elem(@t2, b5))
          |> bxor(elem(@t1, b6))
          |> bxor(elem(@t0, b7))
          |> bxor(elem(@t6, crc >>> 8))
          |> bxor(elem(@t7, crc &&& 0xFF))

        blocks(rest, size - 8, crc, last)
    end
  end

  defp add(crc, byte), do: bxor(crc >>> 8, elem(@t0, bxor(crc &&& 0xFF, byte)))

  @doc """
  MAVLink's CRC-32 (F15) of `data`, continued from `crc`: reflected polynomial 0xEDB88320, initial value 0, no final
  XOR. To continue, pass the last result.

      iex> MavCodec.CRC.crc32("123456789")
      0x2DFD2D88
  """
  @spec crc32(iodata(), 0..0xFFFF_FFFF) :: 0..0xFFFF_FFFF
  def crc32(data, crc \\ 0) do
    # The runtime's CRC-32 inverts the register before and after; inverting once more on each side undoes that.
    bxor(:erlang.crc32(bxor(crc, 0xFFFF_FFFF), data), 0xFFFF_FFFF)
  end
end
