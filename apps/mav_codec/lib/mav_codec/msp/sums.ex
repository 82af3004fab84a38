defmodule MavCodec.Msp.Sums do
  @moduledoc """
  Running checksums of a buffer, so that the check of any part of it takes the same time, however long the part is. Without
  them bytes that look like many long frames would be summed up again for each.
  """

  import Bitwise

  alias MavCodec.CRC.DvbS2

  defstruct sums: <<0, 0>>, xor: 0, crc: 0

  @typedoc "`sums`: XOR and CRC-8 up to each byte of the buffer; `xor`, `crc`: those of the whole buffer."
  @type t :: %__MODULE__{sums: binary, xor: byte, crc: byte}

  @doc "With the sums of `bytes`, which are appended to the buffer."
  @spec append(t, binary) :: t
  def append(%__MODULE__{} = sums, bytes), do: append(bytes, sums.sums, sums.xor, sums.crc)

  defp append(<<byte, rest::binary>>, sums, xor, crc) do
    xor = bxor(xor, byte)
    crc = DvbS2.next(crc, byte)
    append(rest, <<sums::binary, xor, crc>>, xor, crc)
  end

  defp append(<<>>, sums, xor, crc), do: %__MODULE__{sums: sums, xor: xor, crc: crc}

  @doc "Without those of the first `count` bytes."
  @spec drop(t, non_neg_integer) :: t
  def drop(sums, 0), do: sums

  def drop(%__MODULE__{sums: bytes} = sums, count),
    do: %{sums | sums: :binary.copy(binary_part(bytes, 2 * count, byte_size(bytes) - 2 * count))}

  @doc "The XOR of the bytes from `from` to before `to`."
  @spec xor(t, non_neg_integer, non_neg_integer) :: byte
  def xor(%__MODULE__{sums: sums}, from, to), do: bxor(:binary.at(sums, 2 * from), :binary.at(sums, 2 * to))

  @doc "The CRC-8 of the bytes from `from` to before `to`."
  @spec crc(t, non_neg_integer, non_neg_integer) :: byte
  def crc(%__MODULE__{sums: sums}, from, to) do
    before = :binary.at(sums, 2 * from + 1)
    bxor(:binary.at(sums, 2 * to + 1), DvbS2.zeros(before, to - from))
  end
end
