defmodule MavCodec.Test.Wire do
  @moduledoc "Bytes for tests of the parser, and the brute-force scan that it is compared with."

  alias MavCodec.{CRC, Frame, Messages, Parser}
  alias MavCodec.Frame.Raw

  @doc "A v2 frame of a known message, about 30 bytes."
  def attitude(options \\ []) do
    MavCodec.encode(
      %Messages.Attitude{time_boot_ms: 1000 + Keyword.get(options, :seq, 0), roll: 0.5, yawspeed: -1.0},
      Keyword.put_new(options, :system, 1)
    )
  end

  @doc "A heartbeat of 21 bytes (17 with version 1)."
  def heartbeat(options \\ []) do
    MavCodec.encode(
      %Messages.Heartbeat{type: 2, autopilot: 3, base_mode: 81, system_status: 4, mavlink_version: 3},
      Keyword.put_new(options, :system, 1)
    )
  end

  @doc "A message of a ground station as it comes off the wire: NaN, cut zeros, and numbers of the fields' sizes."
  def decoded(message) do
    {:ok, message} = message |> MavCodec.encode(system: 255) |> Frame.from_bytes(nil) |> MavCodec.decode()
    message
  end

  @doc "A frame with an id that no dialect has."
  def unknown(options \\ []) do
    Raw.frame(
      Keyword.get(options, :id, 54_321),
      Keyword.get(options, :payload, <<1, 2, 3, 4, 5>>),
      77,
      Keyword.put_new(options, :system, 1)
    )
  end

  @doc "The same bytes with byte `at` changed."
  def damage(bytes, at) do
    <<before::binary-size(^at), byte, rest::binary>> = bytes
    <<before::binary, Bitwise.bxor(byte, 0x55), rest::binary>>
  end

  @doc "Pushes each chunk and flushes: all frames and the parser."
  def parse(chunks, options \\ []) do
    {frames, parser} =
      Enum.flat_map_reduce(List.wrap(chunks), Parser.new(options), &Parser.push(&2, &1))

    {rest, parser} = Parser.flush(parser)
    {frames ++ rest, parser}
  end

  @doc "The bytes of all frames of known ids: at each byte, header, length and CRC; one byte on when it is none."
  def scan(data, dialect \\ MavCodec.Dialects.All), do: scan(data, dialect, true, [])

  defp scan(<<>>, _dialect, _due?, acc), do: Enum.reverse(acc)

  defp scan(<<_, rest::binary>> = data, dialect, due?, acc) do
    with {:ok, header, len, size, id, system} when system > 0 <- Frame.header(data),
         true <- byte_size(data) >= size and flags(data) in [0, 1],
         extra when extra != nil <- dialect.crc_extra(id),
         true <- due? or length?(data, dialect, id, len),
         true <- checksum(data, header + len, extra) do
      <<bytes::binary-size(^size), rest::binary>> = data
      scan(rest, dialect, true, [bytes | acc])
    else
      _no_frame -> scan(rest, dialect, false, acc)
    end
  end

  # Version 1 cuts nothing (F9): behind damage, a header of another length is noise, whatever its CRC.
  defp length?(<<0xFE, _::binary>>, dialect, id, len),
    do: not function_exported?(dialect, :length, 1) or match?({^len, _}, dialect.length(id))

  defp length?(_v2, _dialect, _id, _len), do: true

  defp flags(<<0xFD, _len, flags, _::binary>>), do: flags
  defp flags(_v1), do: 0

  defp checksum(data, covered, extra) do
    <<_magic, rest::binary>> = binary_part(data, 0, covered)
    CRC.x25(<<rest::binary, extra>>) == data |> binary_part(covered, 2) |> :binary.decode_unsigned(:little)
  end
end
