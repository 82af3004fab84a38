defmodule MavCodec.Sniff.Ublox do
  @moduledoc "Finds UBX, the binary protocol of u-blox GPS receivers: `B5 62`, class, id, length, payload, checksum."

  import Bitwise

  alias MavCodec.Sniff

  @doc "At most one finding."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    case messages(bytes, []) do
      [] ->
        []

      sizes ->
        [
          %{
            protocol: :ublox,
            units: length(sizes),
            bytes: Enum.sum(sizes),
            chance: 0.01,
            evidence: Sniff.count(length(sizes), "message")
          }
        ]
    end
  end

  defp messages(
         <<0xB5, 0x62, class, id, size::16-little, payload::binary-size(size), a, b, rest::binary>> = bytes,
         found
       ) do
    if fletcher(<<class, id, size::16-little, payload::binary>>) == {a, b},
      do: messages(rest, [size + 8 | found]),
      else: messages(binary_part(bytes, 1, byte_size(bytes) - 1), found)
  end

  defp messages(<<_byte, rest::binary>>, found), do: messages(rest, found)
  defp messages(<<>>, found), do: found

  defp fletcher(bytes) do
    for <<byte <- bytes>>, reduce: {0, 0} do
      {a, b} -> {a + byte &&& 0xFF, b + a + byte &&& 0xFF}
    end
  end
end
