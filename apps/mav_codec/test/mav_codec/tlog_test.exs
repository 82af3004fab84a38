defmodule MavCodec.TlogTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire

  alias MavCodec.{Frame, Messages, Parser, Signing, Tlog}
  alias MavCodec.Signing.Redact
  alias MavCodec.Test.Captures

  @at 1_795_216_285_745_000

  defp record(bytes, at), do: <<at::64, bytes::binary>>

  defp decode(chunks, options \\ []) do
    {items, decoder} =
      chunks |> List.wrap() |> Enum.flat_map_reduce(Tlog.Decoder.new(options), &Tlog.Decoder.push(&2, &1))

    items ++ Tlog.Decoder.finish(decoder)
  end

  defp frame(bytes, at \\ @at) do
    {[frame], _} = Parser.push_datagram(Parser.new(), bytes, at)
    frame
  end

  describe "decoder" do
    test "G1: eight bytes of time, big-endian, and the frame" do
      [first, second] = decode(record(heartbeat(), @at) <> record(attitude(version: 1), @at + 5))
      assert %Frame{at: @at, id: 0, version: 2, crc_extra: 50} = first
      assert %Frame{id: 30, version: 1} = second
      assert second.at == @at + 5
      assert [first.bytes, second.bytes] == [heartbeat(), attitude(version: 1)]
    end

    test "any chunking gives the same" do
      data =
        for i <- 0..9,
            into: <<>>,
            do: record(Enum.at([heartbeat(), attitude(), unknown()], rem(i, 3)), @at + i)

      data = damage(data, 40) <> <<1, 2, 3>>
      whole = decode(data)
      assert whole == decode(for <<byte <- data>>, do: <<byte>>)
      assert length(whole) == 11
    end

    test "a cut-off tail is reported and the rest kept" do
      data = record(heartbeat(), @at) <> record(attitude(), @at + 1)

      for cut <- 1..(byte_size(attitude()) + 7) do
        assert [%Frame{id: 0}, %Tlog.Damage{kind: :cut_off, offset: 29, bytes: bytes} = damage] =
                 decode(binary_part(data, 0, byte_size(data) - cut))

        assert bytes == byte_size(attitude()) + 8 - cut
        assert Tlog.Damage.format(damage) =~ "ends in the middle of a record"
      end
    end

    test "a damaged record costs itself" do
      records = for i <- 0..4, do: record(attitude(seq: i), @at + i)
      size = byte_size(hd(records))

      for at <- 8..(size - 1) do
        data = records |> List.update_at(2, &damage(&1, at)) |> IO.iodata_to_binary()
        items = decode(data)
        known = for %Frame{crc_extra: extra, seq: seq} when extra != nil <- items, do: seq
        assert known == [0, 1, 3, 4]

        # A damaged id is an unknown id, whose frames are kept; anything else is left out.
        case items -- Enum.filter(items, &match?(%Frame{crc_extra: 39}, &1)) do
          [%Frame{crc_extra: nil}] -> assert at in 15..17
          [damage] -> assert damage == %Tlog.Damage{kind: :damaged, offset: 2 * size, bytes: size}
        end
      end
    end

    test "missing and additional bytes are damage, the next records are found" do
      data =
        record(heartbeat(), @at) <>
          "xyz" <> record(attitude(), @at + 1) <> binary_part(record(attitude(), @at), 0, 15)

      assert [%Frame{}, %Tlog.Damage{bytes: 3}, %Frame{at: at}, %Tlog.Damage{bytes: 15}, %Frame{id: 0}] =
               decode(data <> record(heartbeat(), @at + 2))

      assert at == @at + 1
    end

    test "a damaged time does not cost the frame" do
      data =
        record(heartbeat(), @at) <> damage(record(attitude(), @at + 1), 0) <> record(heartbeat(), @at + 2)

      assert [%Frame{at: @at}, %Frame{id: 30, at: @at}, %Frame{at: last}] = decode(data)
      assert last == @at + 2
    end

    test "a recorder without a clock, whose time begins in 1970" do
      assert [%Frame{at: 5}, %Frame{at: 1_000_000}] =
               decode(record(heartbeat(), 5) <> record(heartbeat(), 1_000_000))
    end

    test "unknown ids are kept where records follow" do
      data = record(unknown(), @at) <> record(heartbeat(), @at + 1) <> record(unknown(), @at + 2)
      assert [%Frame{crc_extra: nil}, %Frame{id: 0}, %Frame{crc_extra: nil}] = decode(data)

      assert [%Tlog.Damage{}, %Frame{id: 0}] =
               decode(record(unknown(), @at) <> "0123456789" <> record(heartbeat(), @at))
    end
  end

  describe "files" do
    @describetag :tmp_dir

    test "what was written is read", %{tmp_dir: dir} do
      path = Path.join(dir, "a.tlog")
      frames = for i <- 0..999, do: frame(attitude(seq: rem(i, 256)), @at + i)
      File.write!(path, Tlog.records(frames ++ [frame(heartbeat(), @at + 1000)]))
      assert File.stat!(path).size == Enum.sum(Enum.map(frames, &(byte_size(&1.bytes) + 8))) + 29
      assert path |> Tlog.Reader.stream!() |> Enum.to_list() == frames ++ [frame(heartbeat(), @at + 1000)]

      File.write!(path, Tlog.records([%{frame(heartbeat()) | at: nil}]), [:append])
      assert path |> Tlog.Reader.frames!() |> Enum.count() == 1002
      assert [%Frame{at: at}] = path |> Tlog.Reader.frames!() |> Enum.take(-1)
      assert at > @at - 1_000_000_000_000_000
    end

    test "a real recording, cut off", %{tmp_dir: dir} do
      path = Path.join(dir, "px4.tlog")
      data = Captures.read("px4_flight_start.tlog")
      File.write!(path, binary_part(data, 0, byte_size(data) - 5))
      items = path |> Tlog.Reader.stream!() |> Enum.to_list()
      assert Enum.count(items, &is_struct(&1, Frame)) == 1999
      assert %Tlog.Damage{kind: :cut_off} = List.last(items)

      assert Enum.map(Enum.take(items, 1999), & &1.at) ==
               "px4_flight_start.tlog" |> Captures.records() |> Enum.take(1999) |> Enum.map(&elem(&1, 0))
    end

    test "errors are those of the file", %{tmp_dir: dir} do
      assert_raise File.Error, fn ->
        dir |> Path.join("none.tlog") |> Tlog.Reader.frames!() |> Enum.to_list()
      end
    end
  end

  describe "S9: secrets" do
    @key :crypto.hash(:sha256, "gateway-capture-signing-key")

    test "the key of a recorded SETUP_SIGNING does not get into a log" do
      {frames, _} = Parser.push(Parser.new(), Captures.read("arducopter_signed_tx.bin"), @at)
      assert Enum.any?(frames, &(:binary.match(&1.bytes, @key) != :nomatch))
      log = frames |> Tlog.records() |> IO.iodata_to_binary()
      assert :binary.match(log, @key) == :nomatch
      read = decode(log)
      assert length(read) == 100
      setup = Enum.find(read, &(&1.id == 256))
      assert {:ok, %Messages.SetupSigning{secret_key: key, initial_timestamp: time}} = MavCodec.decode(setup)
      assert key == :binary.copy(<<0xFF>>, 32)
      assert time > 0
      assert Enum.count(read, &Frame.signed?/1) > 0
      stripped = frames |> Tlog.records(signatures: false) |> IO.iodata_to_binary() |> decode()
      assert length(stripped) == 100
      refute Enum.any?(stripped, &Frame.signed?/1)
    end

    test "nor does that of a signed, truncated or unknown one" do
      {bytes, _} = Signing.encode(Signing.new(@key), %Messages.SetupSigning{secret_key: @key}, system: 255)
      assert %Frame{signature: nil, system: 255, at: @at} = redacted = Redact.frame(frame(bytes))
      assert redacted.payload == <<0::80>> <> :binary.copy(<<0xFF>>, 32)
      short = frame(MavCodec.encode(%Messages.SetupSigning{target_system: 1}, system: 255))
      assert {:ok, %{target_system: 1}} = MavCodec.decode(Redact.frame(short))
      {[unknown], _} = Parser.push_datagram(Parser.new(dialects: []), bytes)
      assert :binary.match(Redact.frame(unknown).bytes, @key) == :nomatch
    end

    test "other frames stay" do
      assert Redact.frame(frame(attitude())) == frame(attitude())
    end
  end
end
