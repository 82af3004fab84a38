defmodule MavCodec.ParserPropertiesTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire

  alias MavCodec.{Messages, Parser}
  alias MavCodec.Test.TinyDialect

  defp holds(property, tests \\ 200),
    do: assert(:proper.quickcheck(property, [:quiet, {:numtests, tests}]) == true)

  defp good do
    let(
      {:proper_types.range(0, 255), :proper_types.oneof([1, 2]), :proper_types.oneof([:a, :b, :c, :d, :e])},
      fn {seq, version, what} -> message(what, seq: seq, version: version, system: 1) end
    )
  end

  defp message(:a, options), do: attitude(options)
  defp message(:b, options), do: heartbeat(options)

  defp message(:c, options),
    do: MavCodec.encode(%Messages.Statustext{severity: 6, text: "Arming motors"}, options)

  defp message(:d, options), do: MavCodec.encode(%Messages.CommandLong{command: 0xFDFE, param1: 1.0}, options)
  # A payload full of magics.
  defp message(:e, options),
    do:
      MavCodec.encode(
        %Messages.Statustext{severity: 0xFD, text: String.duplicate(<<0xFD, 0xFE>>, 20)},
        options
      )

  defp let(type, fun), do: :proper_types.bind(type, fun, false)

  # No magic in it, so it cannot claim bytes behind it.
  defp text, do: :proper_types.list(:proper_types.range(0, 0xFC)) |> let(&:binary.list_to_bin/1)

  defp magics,
    do: :proper_types.list(:proper_types.oneof([0xFD, 0xFE, 0, 1, 9, 255, 30])) |> let(&:binary.list_to_bin/1)

  defp strange, do: let(:proper_types.range(0, 255), &unknown(seq: &1))

  defp part(good),
    do: let({good, :proper_types.range(1, 12)}, fn {f, n} -> binary_part(f, 0, byte_size(f) - n) end)

  defp stream do
    good = good()

    :proper_types.list(
      :proper_types.oneof([good, good, text(), magics(), strange(), :proper_types.binary(), part(good)])
    )
    |> let(&IO.iodata_to_binary/1)
  end

  defp cut(data, []), do: [data]

  defp cut(data, [size | sizes]) do
    size = min(size, byte_size(data))
    <<chunk::binary-size(^size), rest::binary>> = data
    [chunk | cut(rest, sizes)]
  end

  test "any split gives the same frames and the same counts" do
    sizes = :proper_types.list(:proper_types.range(0, 70))

    for dialects <- [[MavCodec.Dialects.All], [TinyDialect]] do
      holds(
        :proper.forall({stream(), sizes}, fn {data, sizes} ->
          {whole, parser} = parse(data, dialects: dialects)
          {parts, other} = parse(cut(data, sizes), dialects: dialects)
          {bytes, third} = parse(for(<<byte <- data>>, do: <<byte>>), dialects: dialects)
          stats = Parser.stats(parser)
          whole == parts and whole == bytes and stats == Parser.stats(other) and stats == Parser.stats(third)
        end),
        300
      )
    end
  end

  test "an unknown frame right before the first known one of its source counts the same, however it is cut" do
    data = unknown(seq: 252, system: 1, component: 1) <> attitude(seq: 253, system: 1, component: 1)

    [whole, bytes] =
      for chunks <- [data, for(<<byte <- data>>, do: <<byte>>)] do
        {_frames, parser} = parse(chunks)
        Parser.stats(parser).sources
      end

    assert whole == bytes
    assert %{{1, 1} => %{received: 1}} = whole
  end

  test "every byte is in a frame, or counted" do
    holds(
      :proper.forall(stream(), fn data ->
        {frames, parser} = parse(data)
        stats = Parser.stats(parser)
        inside = frames |> Enum.map(&byte_size(&1.bytes)) |> Enum.sum()

        stats.bytes == byte_size(data) and stats.held == 0 and
          (stats.incompatible > 0 or inside + stats.resync_bytes == byte_size(data))
      end)
    )
  end

  test "garbage never raises, in streams, datagrams, with and without long ids" do
    holds(
      :proper.forall(
        {:proper_types.list(:proper_types.oneof([:proper_types.binary(), magics()])),
         :proper_types.boolean()},
        fn
          {chunks, sysid32} ->
            {_, parser} = parse(chunks, sysid32: sysid32)
            {_, _} = Enum.flat_map_reduce(chunks, Parser.new(sysid32: sysid32), &Parser.push_datagram(&2, &1))
            Parser.stats(parser).held == 0
        end
      )
    )
  end

  test "garbage between frames hides none of them: the frames of known ids are those of the brute-force scan" do
    for dialect <- [MavCodec.Dialects.All, TinyDialect] do
      holds(
        :proper.forall(stream(), fn data ->
          {frames, _} = parse(data, dialects: [dialect])
          for(f <- frames, f.crc_extra, do: f.bytes) == scan(data, dialect)
        end),
        400
      )
    end
  end

  test "text between frames: every frame is found, in order" do
    holds(
      :proper.forall(:proper_types.list({text(), good()}), fn pairs ->
        {frames, parser} = parse(Enum.map(pairs, &Tuple.to_list/1) |> IO.iodata_to_binary())

        Enum.map(frames, & &1.bytes) == Enum.map(pairs, &elem(&1, 1)) and
          Parser.stats(parser).resync_bytes == pairs |> Enum.map(&byte_size(elem(&1, 0))) |> Enum.sum()
      end)
    )
  end

  test "a datagram of garbage costs no frame of the others" do
    datagram =
      :proper_types.oneof([
        {:good, :proper_types.non_empty(:proper_types.list(good()))},
        {:bad, :proper_types.binary()},
        {:bad, magics()}
      ])

    holds(
      :proper.forall(:proper_types.list(datagram), fn datagrams ->
        sent = for {:good, frames} <- datagrams, frame <- frames, do: frame

        {got, parser} =
          Enum.flat_map_reduce(datagrams, Parser.new(), fn {_, bytes}, parser ->
            Parser.push_datagram(parser, IO.iodata_to_binary(bytes))
          end)

        {last, _} = Parser.flush(parser)
        sent -- Enum.map(got ++ last, & &1.bytes) == []
      end)
    )
  end

  test "one per cent of the bytes damaged: every undamaged frame is found" do
    :rand.seed(:exsss, {1, 2, 3})

    {data, whole} =
      Enum.map_reduce(0..2999, [], fn i, whole ->
        frame = message(Enum.at([:a, :b, :c, :d], rem(i, 4)), seq: rem(i, 256), system: 1)

        damaged =
          for <<byte <- frame>>,
            into: <<>>,
            do: <<if(:rand.uniform(100) == 1, do: :rand.uniform(256) - 1, else: byte)>>

        {damaged, if(damaged == frame, do: [frame | whole], else: whole)}
      end)

    data = IO.iodata_to_binary(data)
    whole = Enum.reverse(whole)
    assert length(whole) in 1500..2700
    {frames, parser} = parse(data)
    found = for f <- frames, f.crc_extra, do: f.bytes
    assert whole -- found == []
    assert found == scan(data)
    assert Parser.stats(parser).crc_errors > 0
  end
end
