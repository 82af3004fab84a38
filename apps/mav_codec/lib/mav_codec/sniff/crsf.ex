defmodule MavCodec.Sniff.Crsf do
  @moduledoc """
  Finds CRSF, the protocol between radio control receivers (Crossfire, ExpressLRS) and flight controllers: address, length,
  type, payload, CRC.
  """

  alias MavCodec.Sniff
  alias MavCodec.CRC.DvbS2

  # Flight controller, transmitter module, receiver, radio handset.
  @addresses [0xC8, 0xEE, 0xEC, 0xEA]
  @types %{
    0x02 => "GPS",
    0x08 => "battery",
    0x0B => "heartbeat",
    0x14 => "link statistics",
    0x16 => "channels",
    0x1E => "attitude",
    0x21 => "flight mode"
  }

  @doc "At most one finding."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    case frames(bytes, []) do
      [] ->
        []

      frames ->
        kinds =
          frames |> Enum.map(fn {type, _size} -> @types[type] || "others" end) |> Enum.uniq() |> Enum.sort()

        [
          %{
            protocol: :crsf,
            units: length(frames),
            bytes: frames |> Enum.map(&elem(&1, 1)) |> Enum.sum(),
            chance: 0.3,
            evidence: "#{Sniff.count(length(frames), "frame")} (#{Enum.join(kinds, ", ")})"
          }
        ]
    end
  end

  defp frames(<<address, length, body::binary-size(length), rest::binary>> = bytes, found)
       when address in @addresses and length in 2..62 do
    if DvbS2.of(body) == 0,
      do: frames(rest, [{:binary.first(body), length + 2} | found]),
      else: frames(binary_part(bytes, 1, byte_size(bytes) - 1), found)
  end

  defp frames(<<_byte, rest::binary>>, found), do: frames(rest, found)
  defp frames(<<>>, found), do: found
end
