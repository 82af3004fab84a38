defmodule MavCodec.Conformance.SigningTest do
  @moduledoc "Signed frames of every message, made by pymavlink: verified, and signed to the same bytes."
  use ExUnit.Case, async: true

  alias MavCodec.{Frame, Golden, Parser, Signing}

  setup_all do
    %{messages: Golden.messages()}
  end

  test "S1: signed frames are verified, and signed to the same bytes", context do
    signed =
      for message <- context.messages, golden <- message.frames, golden.signed do
        check(message.dialect, golden)
      end

    assert length(signed) >= 400
  end

  defp check(dialect, golden) do
    {[frame], _} = Parser.push(Parser.new(dialects: [dialect]), golden.signed)
    %{link_id: link, timestamp: timestamp} = frame.signature
    clock = fn -> Signing.to_unix(timestamp - 1) end
    signing = Signing.new(Golden.key(), link_id: link, clock: clock)
    options = [system: frame.system, component: frame.component, seq: frame.seq, dialect: dialect]

    assert {:signed, _} = Signing.check(signing, frame)
    assert {golden.signed, timestamp} == stamped(Signing.encode(signing, golden.message, options))

    assert {golden.signed, timestamp} ==
             stamped(Signing.sign(signing, golden.v2, dialect.crc_extra(frame.id)))

    assert Signing.strip(frame) == Frame.from_bytes(golden.v2, frame.crc_extra)
  end

  defp stamped({bytes, signing}), do: {bytes, Signing.timestamp(signing)}
end
