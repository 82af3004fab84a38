defmodule MavCodec.Ftp.PacketTest do
  use ExUnit.Case, async: true

  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages.{FileTransferProtocol, Heartbeat}

  @read %Packet{seq: 0x0102, session: 3, opcode: 5, size: 239, offset: 0x01020304}

  defp message(payload), do: %FileTransferProtocol{target_system: 1, target_component: 1, payload: payload}

  test "a header of 12 bytes, little-endian, and data padded with zeros" do
    assert <<2, 1, 3, 5, 239, 0, 0, 0, 4, 3, 2, 1, padding::binary-size(239)>> = Packet.encode(@read)
    assert padding == <<0::size(239 * 8)>>

    packet = %Packet{opcode: 128, size: 2, request: 15, complete: true, data: "ab"}
    assert <<0, 0, 0, 128, 2, 15, 1, 0, 0::32, "ab", 0::size(237 * 8)>> = Packet.encode(packet)
    assert_raise FunctionClauseError, fn -> Packet.encode(%{packet | data: String.duplicate("a", 240)}) end
  end

  test "what was encoded is decoded, also through a frame, which cuts zeros" do
    data = :proper_types.binary()

    property =
      :proper.forall(
        {data, :proper_types.range(0, 0xFFFF), :proper_types.byte(), :proper_types.boolean()},
        fn {data, seq, byte, complete} ->
          data = binary_part(data, 0, min(byte_size(data), Packet.max_data()))

          packet = %Packet{
            seq: seq,
            session: byte,
            opcode: 255 - byte,
            size: byte_size(data),
            request: byte,
            complete: complete,
            offset: seq * 0xFFFF,
            data: data
          }

          bytes = packet |> Packet.message({1, 191}) |> MavCodec.encode(system: 255, component: 190)
          {[frame], _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)
          {:ok, message} = MavCodec.decode(frame)

          Packet.decode(Packet.encode(packet)) == {:ok, packet} and Packet.request(message) == {:ok, packet} and
            {message.target_system, message.target_component} == {1, 191}
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  test "damaged payloads: a part of a header is an error, a part of the data is what there is" do
    payload = Packet.encode(%{@read | data: String.duplicate("x", 239)})

    for size <- 0..11, do: assert(Packet.decode(binary_part(payload, 0, size)) == :error)

    for size <- 12..251 do
      assert {:ok, %{size: 239, data: data}} = Packet.decode(binary_part(payload, 0, size))
      assert byte_size(data) == size - 12
    end

    property =
      :proper.forall(:proper_types.binary(), fn bytes ->
        case Packet.decode(bytes) do
          {:ok, packet} -> byte_size(packet.data) <= packet.size
          :error -> byte_size(bytes) < 12
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  test "an answer is an ACK or a NAK with all of its data; everything else is not" do
    ack = %Packet{seq: 8, session: 3, opcode: 128, size: 3, request: 5, data: "abc"}
    assert Packet.answer(message(Packet.encode(ack))) == {:ack, ack}
    nak = %{ack | opcode: 129, size: 1, data: <<6>>}
    assert Packet.answer(message(Packet.encode(nak))) == {:nak, nak}

    for other <- [
          message(Packet.encode(@read)),
          message(Packet.encode(%{ack | size: 240})),
          message(binary_part(Packet.encode(ack), 0, 14)),
          message("short"),
          message(""),
          %Heartbeat{}
        ],
        do: assert(Packet.answer(other) == :other)

    assert Packet.request(%Heartbeat{}) == :error
    assert Packet.request(message("short")) == :error
  end

  test "a server answers with the next number, of the session and place that were asked for" do
    assert Packet.ack(@read, "abc") == %Packet{
             seq: 0x0103,
             session: 3,
             opcode: 128,
             size: 3,
             request: 5,
             offset: 0x01020304,
             data: "abc"
           }

    assert %{seq: 0, opcode: 129, size: 1, data: <<6>>} = Packet.nak(%{@read | seq: 0xFFFF}, :eof)
  end

  test "every reason of a refusal comes through; those of errno have their number" do
    reasons =
      [:eof, :failed, :file_not_found, :file_exists, :file_protected, :invalid_session] ++
        [:no_sessions, :unknown_command, :invalid_size, {:errno, 28}, {:error, 77}]

    for reason <- reasons do
      assert {:nak, packet} = Packet.answer(Packet.message(Packet.nak(@read, reason), {1, 1}))
      assert Packet.error(packet) == reason
    end

    # errno's ENOENT, errno without its number, nothing at all, and no error (MAV_FTP_ERR_NONE).
    for {data, reason} <- [{<<2, 2>>, :file_not_found}, {<<2>>, :failed}, {"", :failed}, {<<0>>, {:error, 0}}],
        do: assert(Packet.error(%Packet{data: data}) == reason)
  end

  test "opcodes are those of MAVLink; an unknown one is not an operation" do
    assert Packet.opcode(:list) == 3
    assert Packet.operation(@read) == :read
    for code <- [0, 9, 10, 12, 13, 99, 128, 255], do: assert(Packet.operation(%Packet{opcode: code}) == nil)
  end
end
