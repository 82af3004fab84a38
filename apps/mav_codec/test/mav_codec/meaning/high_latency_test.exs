defmodule MavCodec.Meaning.HighLatencyTest do
  use ExUnit.Case, async: true

  alias MavCodec.Meaning.HighLatency
  alias MavCodec.MessageId
  alias MavCodec.Frame
  alias MavCodec.Messages

  defp carries?(message),
    do: message |> MavCodec.encode(system: 1) |> Frame.from_bytes(nil) |> HighLatency.carries?()

  test "X6: commands and their answers are carried, requests for more data and streams are not" do
    assert carries?(%Messages.CommandLong{command: 400})
    assert carries?(%Messages.CommandAck{command: 400})
    assert carries?(%Messages.HighLatency2{})
    refute carries?(%Messages.CommandLong{command: 511})
    refute carries?(%Messages.CommandInt{command: 512})
    refute carries?(%Messages.Heartbeat{})
    refute carries?(%Messages.Attitude{})
  end

  test "a message that is not in the definitions has no id" do
    assert MessageId.of!("HEARTBEAT") == 0
    assert_raise ArgumentError, ~r/no message HEART/, fn -> MessageId.of!("HEART") end
  end
end
