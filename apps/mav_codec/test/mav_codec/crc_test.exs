defmodule MavCodec.CRCTest do
  use ExUnit.Case, async: true
  import Bitwise
  alias MavCodec.CRC

  doctest MavCodec.CRC

  # The definition, bit by bit.
  defp reference(data, crc \\ 0xFFFF) do
    for <<byte <- data>>, reduce: crc do
      crc -> Enum.reduce(1..8, bxor(crc, byte), fn _, crc -> (crc >>> 1) |> bxor((crc &&& 1) * 0x8408) end)
    end
  end

  test "F5: CRC-16/MCRF4XX, for every length and any alignment" do
    data = :crypto.hash(:sha512, "x") <> :crypto.hash(:sha512, "y")

    for from <- 0..8, size <- 0..100 do
      part = binary_part(data, from, size)
      assert CRC.x25(part) == reference(part)
    end
  end

  test "x25 goes on where it stopped" do
    assert CRC.x25("6789", CRC.x25("12345")) == 0x6F91
    assert CRC.x25("", 0x1234) == 0x1234
  end

  test "frame: without the magic, with CRC_EXTRA, and no look at what follows" do
    for size <- 1..40 do
      data = :crypto.strong_rand_bytes(size + 10)
      <<_magic, covered::binary-size(^size), _::binary>> = data
      assert CRC.frame(data, size, 0xA7) == reference(covered <> <<0xA7>>)
    end
  end

  test "F15: MAVLink's CRC32 starts at 0 and has no final XOR" do
    assert CRC.crc32("") == 0
    assert CRC.crc32("123456789") == 0x2DFD2D88
    assert CRC.crc32("6789", CRC.crc32(["12", "345"])) == 0x2DFD2D88
  end
end
