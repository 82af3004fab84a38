defmodule MavCodec.Conformance.FramesTest do
  @moduledoc "Whole frames that pymavlink made, one of every kind for every message, through parser, decoder and encoder."
  use ExUnit.Case, async: true

  alias MavCodec.{Golden, Parser}

  setup_all do
    %{messages: Golden.messages()}
  end

  test "every golden frame is found, and its message encodes to the same bytes", context do
    for message <- context.messages, frame <- message.frames, version <- [:v1, :v2], bytes = frame[version] do
      assert [parsed] = parse(bytes, message.dialect)
      assert {parsed.id, parsed.crc_extra} == {message.id, message.dialect.crc_extra(message.id)}
      {:ok, decoded} = MavCodec.decode(parsed, message.dialect)
      if version == :v2, do: assert(decoded == frame.message)

      assert MavCodec.encode(decoded,
               system: parsed.system,
               component: parsed.component,
               seq: parsed.seq,
               version: parsed.version,
               dialect: message.dialect
             ) == bytes,
             "#{message.name} #{frame.kind} #{version}"
    end
  end

  test "signed frames hold the same message", context do
    for message <- context.messages, frame <- message.frames, frame.signed do
      assert [parsed] = parse(frame.signed, message.dialect)
      assert parsed.signature
      assert MavCodec.decode(parsed, message.dialect) == {:ok, frame.message}
    end
  end

  test "all of them in one stream, v1 and v2 interleaved", context do
    official =
      for %{dialect: dialect} = message <- context.messages,
          dialect == MavCodec.Dialects.Upstream,
          do: message

    bytes =
      for message <- official,
          frame <- message.frames,
          version <- [:v1, :v2, :signed],
          bytes = frame[version],
          do: bytes

    {frames, _parser} =
      Parser.push(Parser.new(dialects: [MavCodec.Dialects.Upstream]), IO.iodata_to_binary(bytes))

    assert length(frames) == length(bytes)
    assert Enum.map(frames, & &1.bytes) == bytes
  end

  defp parse(bytes, dialect) do
    {frames, _parser} = Parser.push(Parser.new(dialects: [dialect]), bytes)
    frames
  end
end
