defmodule MavCodec.ParserTest do
  use ExUnit.Case, async: true

  import Bitwise
  import MavCodec.Test.Wire

  alias MavCodec.{CRC, Frame, Messages, Parser}
  alias MavCodec.Frame.Raw
  alias MavCodec.Test.TinyDialect

  doctest MavCodec

  defp bytes(frames), do: Enum.map(frames, & &1.bytes)
  defp stats(parser), do: Parser.stats(parser)

  # A frame with flags that no encoder of ours would set, its CRC right.
  defp flagged(incompat, body \\ <<0, 7, 1, 1, 0::24>>) do
    head = <<0xFD, 9, incompat>> <> body <> <<0, 0, 0, 0, 2, 3, 81, 4, 3>>
    <<head::binary, CRC.frame(head, byte_size(head) - 1, 50)::16-little>>
  end

  describe "one frame" do
    test "F1, F2: a v2 frame, field by field" do
      data = heartbeat(system: 3, component: 190, seq: 200)
      {[frame], parser} = Parser.push(Parser.new(), data, 1_795_213_318_360_000)

      assert %Frame{
               version: 2,
               seq: 200,
               system: 3,
               component: 190,
               id: 0,
               incompat: 0,
               compat: 0,
               crc_extra: 50,
               signature: nil,
               bytes: ^data,
               at: 1_795_213_318_360_000
             } = frame

      assert frame.payload == <<0::32, 2, 3, 81, 4, 3>>
      assert Frame.known?(frame) and not Frame.signed?(frame)
      assert {:ok, %Messages.Heartbeat{type: 2, base_mode: 81}} = MavCodec.decode(frame)
      assert %{frames: 1, bytes: 21, held: 0, resync_bytes: 0, crc_errors: 0} = stats(parser)
    end

    test "F1: a v1 frame, field by field" do
      data = heartbeat(version: 1, system: 3, component: 190, seq: 200)
      assert <<0xFE, 9, 200, 3, 190, 0, _::binary>> = data
      {[frame], _} = Parser.push(Parser.new(), data)
      assert %Frame{version: 1, seq: 200, system: 3, component: 190, id: 0, bytes: ^data, at: nil} = frame
      assert {:ok, %Messages.Heartbeat{type: 2}} = MavCodec.decode(frame)
    end

    test "F3: system 0 is never a source" do
      <<magic, len, flags::16, seq, _system, rest::binary>> = heartbeat()
      head = <<magic, len, flags::16, seq, 0, binary_part(rest, 0, 13)::binary>>
      data = <<head::binary, CRC.frame(head, 18, 50)::16-little>>
      assert {[], parser} = parse(data)
      assert stats(parser).resync_bytes == 21
      # ... but component 0 is what some ground stations send.
      assert {[%Frame{component: 0}], _} = parse(heartbeat(component: 0))
    end

    test "F6: unknown compatibility flags are ignored" do
      assert {[%Frame{compat: 0xFF}], _} = parse(heartbeat(compat_flags: 0xFF))
    end

    test "F6: unknown incompatibility flags: the frame is dropped and counted, the next one is not" do
      for flags <- [0x08, 0x80, 0xFE] do
        incompatible = if (flags &&& 0x06) == 0, do: flagged(flags), else: long(flags)
        {frames, parser} = parse([incompatible, attitude()])
        assert bytes(frames) == [attitude()]
        assert %{incompatible: 1, resync_bytes: 0, crc_errors: 0, frames: 1} = stats(parser)
      end
    end

    defp long(flags), do: flagged(flags, <<0, 7, 1::32-little, 1, 0::24, 9::32-little>>)

    test "F7, F8: truncated or not, the frame is taken as it is" do
      for truncate <- [true, false] do
        data = heartbeat(truncate: truncate)
        assert {[%Frame{bytes: ^data} = frame], _} = parse(data)
        assert {:ok, %Messages.Heartbeat{custom_mode: 0, type: 2}} = MavCodec.decode(frame)
      end
    end

    test "F9: surplus bytes behind the known payload do not matter" do
      data = Raw.frame(0, <<0::32, 2, 3, 81, 4, 3, 9, 9, 9>>, 50, system: 1)
      assert {[frame], _} = parse(data)
      assert {:ok, %Messages.Heartbeat{mavlink_version: 3}} = MavCodec.decode(frame)
    end

    test "F10: targets that were cut off are a broadcast" do
      long =
        MavCodec.encode(%Messages.CommandLong{target_system: 7, target_component: 1, confirmation: 1},
          system: 255
        )

      cut = MavCodec.encode(%Messages.CommandLong{param1: 1.0}, system: 255)
      {[long, cut], _} = parse([long, cut])
      assert Frame.target(long) == {7, 1}
      assert byte_size(cut.payload) < 30
      assert Frame.target(cut) == {0, 0}
    end

    test "targets: none, only a system, not in the dialect" do
      {[none, system, unknown], _} =
        parse([
          heartbeat(),
          MavCodec.encode(%Messages.SetMode{target_system: 9}, system: 1),
          unknown(),
          heartbeat()
        ])
        |> then(fn {frames, parser} -> {Enum.take(frames, 3), parser} end)

      assert Frame.target(none) == nil
      assert Frame.target(system) == {9, 0}
      assert Frame.target(unknown) == nil
    end
  end

  describe "streams" do
    test "F12: several frames at once, both versions" do
      all = [heartbeat(seq: 1), heartbeat(seq: 2, version: 1), attitude(seq: 3), attitude(seq: 4, version: 1)]
      {frames, parser} = Parser.push(Parser.new(), IO.iodata_to_binary(all))
      assert bytes(frames) == all
      assert Enum.map(frames, & &1.seq) == [1, 2, 3, 4]
      assert stats(parser).frames == 4
    end

    test "byte by byte; a frame has the time of its last byte" do
      data = attitude() <> heartbeat(version: 1)

      {frames, parser} =
        data
        |> :binary.bin_to_list()
        |> Enum.with_index()
        |> Enum.flat_map_reduce(Parser.new(), fn {byte, i}, parser -> Parser.push(parser, <<byte>>, i) end)

      assert bytes(frames) == [attitude(), heartbeat(version: 1)]
      assert Enum.map(frames, & &1.at) == [byte_size(attitude()) - 1, byte_size(data) - 1]
      assert stats(parser).bytes == byte_size(data)
    end

    test "F13: after a wrong CRC the search goes on at the next byte" do
      # The damaged length makes the first frame swallow the second.
      <<magic, _len, rest::binary>> = heartbeat()
      data = <<magic, 40, rest::binary>> <> attitude(seq: 1) <> attitude(seq: 2)
      {frames, parser} = parse(data)
      assert bytes(frames) == [attitude(seq: 1), attitude(seq: 2)]
      assert %{crc_errors: 1, resync_bytes: 21} = stats(parser)
    end

    test "text between frames is counted and costs nothing" do
      text = "ArduCopter V4.6.3 (92b0cd78)\r\n"
      {frames, parser} = parse([text, heartbeat(), text, attitude()])
      assert bytes(frames) == [heartbeat(), attitude()]
      assert stats(parser).resync_bytes == 2 * byte_size(text)
    end

    test "a frame of a known id is taken whatever stands inside it" do
      # FILE_TRANSFER_PROTOCOL carrying a recorded heartbeat.
      outer = MavCodec.encode(%Messages.FileTransferProtocol{payload: heartbeat()}, system: 1)
      {frames, parser} = parse(outer)
      assert bytes(frames) == [outer]
      assert stats(parser).resync_bytes == 0
    end

    test "what is kept is bounded" do
      for data <- [
            :binary.copy(<<0xFE>>, 5000),
            :binary.copy(<<0xFD, 255, 0>>, 2000),
            :binary.copy(unknown(), 50)
          ],
          chunk <- [1, 7, 1000] do
        Enum.reduce(chunks(data, chunk), Parser.new(), fn bytes, parser ->
          {_, parser} = Parser.push(parser, bytes)
          assert stats(parser).held < Parser.max_held()
          parser
        end)
      end
    end

    test "hostile bytes cost a bounded amount of work" do
      # Each byte may begin a frame of up to 300 bytes, whose CRC must be tried; unknown ids are searched inside besides.
      magics = unknown(payload: :binary.copy(<<0xFE, 0xFD, 9, 1, 0>>, 50))

      for data <- [
            :binary.copy(<<0xFE>>, 20_000),
            :binary.copy(<<0xFE, 255, 1, 1, 1, 255>>, 3000),
            :binary.copy(magics, 80)
          ] do
        {:reductions, before} = Process.info(self(), :reductions)
        Enum.reduce(chunks(data, 1400), Parser.new(), &elem(Parser.push(&2, &1), 1))
        {:reductions, after_all} = Process.info(self(), :reductions)
        assert after_all - before < 150 * byte_size(data)
      end
    end

    test "a file pushed at once: its frames are not copied again and again as the heap grows, and the heap is given back" do
      data = :binary.copy(attitude(), 30_000)
      test = self()

      spawn_link(fn ->
        before = Process.info(self(), :garbage_collection) |> elem(1)
        {frames, _} = Parser.push(Parser.new(), data)
        after_all = Process.info(self(), :garbage_collection) |> elem(1)
        send(test, {length(frames), before[:min_heap_size], after_all[:min_heap_size], after_all[:minor_gcs]})
      end)

      assert_receive {30_000, size, size, collections}
      assert collections <= 1
    end

    test "a whole file, frame by frame: the same frames and counts as of one push, of which none are kept" do
      data = String.duplicate(MavCodec.Test.Captures.read("arducopter_flight.bin"), 2)
      {frames, pushed} = Parser.push(Parser.new(), data, 7)
      at = fn frame, [next | frames] -> (^next = frame) && frames end
      assert {[], parser} = Parser.reduce(Parser.new(), data, frames, at, 7)
      assert stats(parser) == stats(pushed)

      test = self()

      spawn_link(fn ->
        words = fn -> self() |> Process.info(:total_heap_size) |> elem(1) end
        most = fn _frame, {n, most} -> {n + 1, max(most, words.())} end
        {result, _parser} = Parser.reduce(Parser.new(), data, {0, 0}, most)
        send(test, result)
      end)

      assert_receive {count, most}
      assert count == length(frames)
      # A frame takes some 30 words.
      assert most < 4 * count
    end

    test "the bytes kept are not a part of what was read" do
      {[], parser} = Parser.push(Parser.new(), :binary.copy("x", 100_000) <> <<0xFD, 9>>)
      assert :binary.referenced_byte_size(parser.held) == 2
    end
  end

  defp chunks(<<>>, _size), do: []
  defp chunks(data, size) when byte_size(data) <= size, do: [data]

  defp chunks(data, size) do
    <<chunk::binary-size(^size), rest::binary>> = data
    [chunk | chunks(rest, size)]
  end

  test "frames that are taken as they are count as if their bytes had been read (R7)" do
    made = for seq <- [3, 4, 7], do: Frame.from_bytes(heartbeat(system: 3, seq: seq), 50)
    {taken, parser} = Parser.take(Parser.new(), made, 12)
    assert {^taken, read} = Parser.push(Parser.new(), IO.iodata_to_binary(bytes(made)), 12)
    assert stats(parser) == stats(read)
  end

  describe "unknown ids" do
    test "are kept as raw frames, when the byte behind them is a magic" do
      data = unknown(seq: 4)
      {[], parser} = Parser.push(Parser.new(), data)
      {frames, parser} = Parser.push(parser, heartbeat(seq: 5))
      assert bytes(frames) == [data, heartbeat(seq: 5)]
      assert %Frame{id: 54_321, crc_extra: nil, payload: <<1, 2, 3, 4, 5>>} = hd(frames)
      refute Frame.known?(hd(frames))
      assert {:error, %MavCodec.Message.DecodeError{id: 54_321}} = MavCodec.decode(hd(frames))
      assert %{unknown_ids: 1, frames: 2, crc_errors: 0, resync_bytes: 0} = stats(parser)
    end

    test "at the end of the data come out with a flush" do
      data = unknown()
      {[], parser} = Parser.push(Parser.new(), data, 5)
      assert {[%Frame{bytes: ^data, at: 5}], parser} = Parser.flush(parser)
      assert {[], ^parser} = Parser.flush(parser)
    end

    test "are noise when no frame can begin behind them" do
      {frames, parser} = parse(unknown() <> "x" <> heartbeat())
      assert bytes(frames) == [heartbeat()]
      assert %{unknown_ids: 0, resync_bytes: size} = stats(parser)
      assert size == byte_size(unknown()) + 1
    end

    test "are noise when a good frame begins inside them" do
      # FE and a length that reaches over the heartbeat to the next frame's magic: v1 id 255 is in no dialect.
      noise = <<0xFE, 21 + 16, 1, 1, 1, 255, 0, 0, 0, 0, 0, 0, 0, 0>>
      data = noise <> heartbeat() <> <<0xFE - 1>> <> "0123456789" <> attitude()
      {frames, _} = parse(data)
      assert bytes(frames) == [heartbeat(), attitude()]
    end

    test "a good frame that begins inside them, even at their last byte, is found, however the bytes are cut" do
      # 253 bytes of payload, nearly all of them magics: the byte behind the noise looks like a magic too.
      data = <<7, 0, :binary.copy(<<0xFE>>, 251)::binary>>
      inside = Raw.frame(131, data, 223, system: 1)
      assert <<0xFD, 0xFD, _::binary>> = inside

      # The noise claims `covered` bytes of the good frame.
      for covered <- [1, 12, 13, 50, 200], filler <- 1..3 do
        noise = <<0xFE, 6 + filler + covered - 8, 1, 1, 1, 255, 0::size(filler)-unit(8)>>
        data = noise <> inside <> heartbeat()
        expected = [inside, heartbeat()]
        assert data |> parse() |> elem(0) |> bytes() == expected
        assert for(<<byte <- data>>, do: <<byte>>) |> parse() |> elem(0) |> bytes() == expected

        for cut <- 1..(byte_size(data) - 1)//5 do
          chunks = [binary_part(data, 0, cut), binary_part(data, cut, byte_size(data) - cut)]
          assert chunks |> parse() |> elem(0) |> bytes() == expected
        end
      end
    end

    test "count in the sequence of a source that is known, and make no source" do
      {_, parser} =
        parse(
          [attitude(seq: 0), unknown(seq: 1), attitude(seq: 2), unknown(seq: 0, system: 9), attitude(seq: 3)],
          []
        )

      assert %{{1, 1} => %{received: 4, lost: 0, missing: 0}} = stats(parser).sources
      assert map_size(stats(parser).sources) == 1
    end
  end

  describe "dialects" do
    test "what is known depends on them" do
      gps = MavCodec.encode(%Messages.GpsRawInt{lat: 1}, system: 1)
      {[heartbeat, gps, _], _} = parse([heartbeat(), gps, attitude()], dialects: [TinyDialect])
      assert Frame.known?(heartbeat)
      refute Frame.known?(gps)

      assert {[_, gps, _], _} =
               parse([heartbeat(), gps.bytes, attitude()], dialects: [TinyDialect, MavCodec.Dialects.All])

      assert Frame.known?(gps)
    end

    defmodule Other do
      # HEARTBEAT with another CRC_EXTRA, and a message above the table's end with two.
      def crc_extra(0), do: 51
      def crc_extra(40_000), do: [7, 8]
      def crc_extra(_), do: nil
    end

    test "several may know one id: the frame keeps the CRC_EXTRA that matched" do
      ours = heartbeat()
      theirs = Raw.frame(0, <<1, 2, 3>>, 51, system: 1)
      seventh = Raw.frame(40_000, <<1>>, 7, system: 1)
      eighth = Raw.frame(40_000, <<1>>, 8, system: 1)
      wrong = Raw.frame(40_000, <<1>>, 9, system: 1)

      {frames, parser} =
        parse([ours, theirs, seventh, eighth, wrong, ours], dialects: [MavCodec.Dialects.All, Other])

      assert bytes(frames) == [ours, theirs, seventh, eighth, ours]
      assert Enum.map(frames, & &1.crc_extra) == [50, 51, 7, 8, 50]
      assert stats(parser).crc_errors == 1
    end
  end

  describe "32-bit system ids" do
    setup do
      command = %Messages.CommandLong{target_system: 70_000, target_component: 1, command: 400}

      %{
        source: heartbeat(system: 100_000, sysid32: true),
        target: MavCodec.encode(command, system: 1, sysid32: true),
        both: MavCodec.encode(command, system: 100_000, sysid32: true)
      }
    end

    test "N1, N2: headers of 13, 14 and 17 bytes, payload with the sentinel", context do
      {[source, target, both], parser} = parse([context.source, context.target, context.both], sysid32: true)
      assert %Frame{system: 100_000, incompat: 0x02, target_system: nil, payload: <<_::72>>} = source
      assert %Frame{system: 1, incompat: 0x04, target_system: 70_000} = target
      assert %Frame{system: 100_000, incompat: 0x06, target_system: 70_000, component: 1, id: 76} = both
      assert Frame.target(both) == {70_000, 1}
      assert Frame.target(source) == nil
      assert {:ok, %Messages.CommandLong{target_system: 255, command: 400}} = MavCodec.decode(both)
      assert byte_size(both.bytes) == byte_size(target.bytes) + 3
      assert %{frames: 3, sources: %{{100_000, 1} => _}} = stats(parser)
    end

    test "N3: without the switch they are dropped and counted, and hide nothing", context do
      {frames, parser} = parse([context.source, attitude(), context.target, context.both, attitude()])
      assert bytes(frames) == [attitude(), attitude()]
      assert %{incompatible: 3, resync_bytes: 0} = stats(parser)
    end

    test "N1: ids up to 255 need no flags, and F3 holds for the long form" do
      assert heartbeat(system: 200, sysid32: true) == heartbeat(system: 200)
      assert {[], parser} = parse(flagged(0x02, <<0, 7, 0::32, 1, 0::24>>), sysid32: true)
      assert stats(parser).frames == 0
    end

    test "without the switch they are not encoded" do
      assert_raise MavCodec.Message.EncodeError, ~r/system/, fn -> heartbeat(system: 256) end
    end
  end

  test "unknown options are refused" do
    assert_raise ArgumentError, ~r/dialect/, fn -> Parser.new(dialect: MavCodec.Dialects.All) end
  end
end
