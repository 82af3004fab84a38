defmodule MavCodec.CRC.DvbS2 do
  @moduledoc "CRC-8/DVB-S2 (polynomial 0xD5, initial value 0), which MSP version 2 and CRSF use."

  import Bitwise

  @table (for byte <- 0..255 do
            Enum.reduce(1..8, byte, fn _bit, crc ->
              if (crc &&& 0x80) != 0, do: bxor(crc <<< 1 &&& 0xFF, 0xD5), else: crc <<< 1
            end)
          end)
         |> List.to_tuple()

  # What zeros behind a byte make of it repeats itself: the table has one row for each number of zeros until then.
  @rows Stream.iterate(Enum.to_list(0..255), fn row -> Enum.map(row, &elem(@table, &1)) end)
        |> Enum.take(256)
  @period 1 + Enum.find_index(tl(@rows), &(&1 == hd(@rows)))
  @shifts for row <- Enum.take(@rows, @period), byte <- row, into: <<>>, do: <<byte>>

  @doc """
  The CRC of all bytes, or of `bytes` behind those whose CRC is given.

      iex> MavCodec.CRC.DvbS2.of("123456789")
      0xBC
      iex> MavCodec.CRC.DvbS2.of("6789", MavCodec.CRC.DvbS2.of("12345"))
      0xBC
  """
  @spec of(binary, byte) :: byte
  def of(bytes, crc \\ 0)
  def of(<<byte, rest::binary>>, crc), do: of(rest, elem(@table, bxor(crc, byte)))
  def of(<<>>, crc), do: crc

  @doc "The CRC after one more byte."
  @spec next(byte, byte) :: byte
  def next(crc, byte), do: elem(@table, bxor(crc, byte))

  @doc """
  The CRC after `count` zeros. The CRC of two pieces in a row is that of the second one, XOR that of the first one after as
  many zeros as the second one has bytes.

      iex> Bitwise.bxor(MavCodec.CRC.DvbS2.of("6789"), MavCodec.CRC.DvbS2.zeros(MavCodec.CRC.DvbS2.of("12345"), 4))
      0xBC
  """
  @spec zeros(byte, non_neg_integer) :: byte
  def zeros(crc, count), do: :binary.at(@shifts, rem(count, @period) * 256 + crc)
end
