defmodule MavCodec.Msp.TraceTest do
  use ExUnit.Case, async: true

  alias MavCodec.{Frame, Parser, Signing}
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Trace

  @options [system: 7, seq: 250, at: 1_700_000_000_000_000]
  @whats [:opened, :tick, :closing, {:bytes, ""}, {:bytes, "$M>" <> <<0, 0, 0>>}, {:written, "$M<"}] ++
           [{:client, 3, :up}, {:client, 3, :down}, {:client, 3, <<0, 0>>}, {:judged, 3, true}] ++
           [{:judged, 3, false}, {:client, 9, ""}]

  defp read(frames) do
    {entries, nil} = Enum.flat_map_reduce(frames, nil, &pushed/2)
    entries
  end

  defp pushed(frame, open) do
    {entry, open} = Trace.push(open, frame)
    {List.wrap(entry), open}
  end

  test "each kind of entry comes back; its frames are those that were counted, and parse as MAVLink" do
    for what <- @whats do
      frames = Trace.frames({-5, what}, @options)
      assert length(frames) == Trace.count(what)
      assert read(frames) == [{-5, what}]
      assert {^frames, _parser} = Parser.push(Parser.new(), Enum.map_join(frames, & &1.bytes), @options[:at])
      assert Enum.all?(frames, &(Trace.frame?(&1) and &1.system == 7))
    end
  end

  test "bytes of any length, the same, and not more frames than they need" do
    property =
      :proper.forall(:proper_types.range(0, 2000), fn size ->
        bytes = :rand.bytes(size)
        frames = Trace.frames({1, {:bytes, bytes}}, @options)

        read(frames) == [{1, {:bytes, bytes}}] and length(frames) == max(ceil(byte_size(bytes) / 116), 1) and
          Enum.map(frames, & &1.seq) ==
            Enum.map(1..length(frames), &Bitwise.band(250 + &1 - 1, 255))
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 200}]) == true
  end

  test "an entry that lacks a frame is left out, and the next one is whole" do
    [a, b, c] = Trace.frames({1, {:bytes, :binary.copy("x", 300)}}, @options)
    next = Trace.frames({2, :tick}, @options)

    for part <- [[a, c], [b, c], [a, b], [a, a, c], [c]] do
      assert read(part ++ next) == [{2, :tick}]
    end

    # Frames of a vehicle between them are none of it.
    other = Frame.from_bytes(MavCodec.encode(%M.Heartbeat{}, system: 7, component: 1), 50, 0)
    refute Trace.frame?(other)
    assert [{1, {:bytes, _}}] = read([a, other, b, c])
  end

  test "another program's TUNNEL, and a damaged one, are not traces" do
    for payload <- ["", "short", <<99, 1, 0::16, 0::64>>, <<8, 1, 0::16, 0::64, 1>>] do
      tunnel = %M.Tunnel{payload_type: 41_080, payload_length: byte_size(payload), payload: payload}
      frame = Frame.from_bytes(MavCodec.encode(tunnel, system: 7, component: 242), nil, 0)
      assert {nil, nil} = Trace.push(nil, frame)
    end

    tunnel = %M.Tunnel{payload_type: 1, payload_length: 12, payload: <<4, 1, 0::80>>}
    refute Trace.frame?(Frame.from_bytes(MavCodec.encode(tunnel, system: 7, component: 242), nil, 0))
  end

  test "neither keys nor signatures (S9)" do
    key = :binary.copy("k", 32)
    setup = MavCodec.encode(%M.SetupSigning{target_system: 7, secret_key: key}, system: 255, component: 190)
    signing = Signing.new(Signing.key("a passphrase"), link_id: 1)

    {signed, _signing} =
      Signing.sign(signing, MavCodec.encode(%M.Heartbeat{}, system: 255, component: 190), 50)

    assert [{1, {:mavlink, bytes}}] =
             read(Trace.frames({1, {:mavlink, setup <> IO.iodata_to_binary(signed)}}, @options))

    refute bytes =~ "kkkk"
    assert {[%{id: 256}, %{id: 0, signature: nil}], _parser} = Parser.push(Parser.new(), bytes, 0)
  end
end
