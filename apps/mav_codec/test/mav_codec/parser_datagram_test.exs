defmodule MavCodec.ParserDatagramTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire

  alias MavCodec.{Frame, Parser}

  defp bytes(frames), do: Enum.map(frames, & &1.bytes)
  defp stats(parser), do: Parser.stats(parser)

  describe "datagrams" do
    test "F12: several frames in one, and a frame split over two" do
      data = attitude(seq: 2)
      {frames, parser} = Parser.push_datagram(Parser.new(), heartbeat(seq: 1) <> binary_part(data, 0, 20))
      assert bytes(frames) == [heartbeat(seq: 1)]

      {frames, parser} =
        Parser.push_datagram(parser, binary_part(data, 20, byte_size(data) - 20) <> heartbeat(seq: 3))

      assert bytes(frames) == [data, heartbeat(seq: 3)]
      assert %{resync_bytes: 0, crc_errors: 0} = stats(parser)
    end

    test "a bad datagram costs nothing else" do
      # It begins a frame of 255 bytes that never comes.
      {[], parser} = Parser.push_datagram(Parser.new(), <<0xFD, 255, 0, 0, 0, 1, 1, 0, 0, 0, 1, 2, 3>>)
      {frames, parser} = Parser.push_datagram(parser, heartbeat(), 7)
      assert bytes(frames) == [heartbeat()]
      assert %{resync_bytes: 13, held: 0} = stats(parser)
    end

    test "a good frame behind a bad beginning in the same datagram does not wait" do
      {frames, parser} =
        Parser.push_datagram(Parser.new(), <<0xFD, 255, 0, 0, 0, 1, 1, 0, 0, 0>> <> heartbeat())

      assert bytes(frames) == [heartbeat()]
      assert stats(parser).held == 0
    end

    test "a frame of an unknown id may end with the datagram" do
      data = unknown()
      assert {[%Frame{bytes: ^data}], parser} = Parser.push_datagram(Parser.new(), data)
      assert %{held: 0, unknown_ids: 1} = stats(parser)
    end

    test "an unknown frame that a stream kept is given out before the datagram" do
      {[], parser} = Parser.push(Parser.new(), unknown())
      {frames, _} = Parser.push_datagram(parser, heartbeat())
      assert bytes(frames) == [unknown(), heartbeat()]
    end

    test "boot text as a datagram of its own" do
      {[], parser} = Parser.push_datagram(Parser.new(), "Init ArduCopter V4.6.3\n")
      assert {[_], _} = Parser.push_datagram(parser, heartbeat())
    end
  end

  describe "sequence loss" do
    test "R7, R9: per source, over pushes" do
      frames = for seq <- 0..400, rem(seq, 10) != 9, do: attitude(seq: seq)
      others = for seq <- 0..400, do: heartbeat(seq: seq, component: 154)
      all = Enum.zip_with([frames ++ frames, others], &Enum.to_list/1) |> List.flatten()
      {_, parser} = parse(all)
      assert %{{1, 1} => %{ratio: ratio}, {1, 154} => %{lost: 0}} = stats(parser).sources
      assert_in_delta ratio, 0.1, 0.03
      assert stats(parser).lost == stats(parser).sources[{1, 1}].lost
    end

    test "a source that only sends heartbeats may be a forwarded one: its loss is not known" do
      forwarded = for seq <- 0..400//7, do: heartbeat(system: 254, component: 190, seq: seq)
      {_, parser} = parse(forwarded)
      assert %{{254, 190} => %{ratio: nil, lost: lost}} = stats(parser).sources
      assert lost > 0
      assert stats(parser).lost == 0
    end

    test "sources are bounded" do
      {_, parser} =
        parse(for system <- 1..255, component <- 1..3, do: heartbeat(system: system, component: component))

      assert map_size(stats(parser).sources) == Parser.Sources.limit()
      assert stats(parser).frames == 765
    end
  end
end
