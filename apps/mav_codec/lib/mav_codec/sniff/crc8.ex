defmodule MavCodec.Sniff.Crc8 do
  @moduledoc "CRC-8/DVB-S2 (polynomial 0xD5, initial value 0), which MSP v2 and CRSF use."

  import Bitwise

  @table (for byte <- 0..255 do
            Enum.reduce(1..8, byte, fn _bit, crc ->
              if (crc &&& 0x80) != 0, do: bxor(crc <<< 1 &&& 0xFF, 0xD5), else: crc <<< 1
            end)
          end)
         |> List.to_tuple()

  @doc """
  The CRC of all bytes.

      iex> MavCodec.Sniff.Crc8.of("123456789")
      0xBC
  """
  @spec of(binary) :: byte
  def of(bytes), do: of(bytes, 0)

  defp of(<<byte, rest::binary>>, crc), do: of(rest, elem(@table, bxor(crc, byte)))
  defp of(<<>>, crc), do: crc
end
