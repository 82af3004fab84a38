defmodule MavCodec.FuzzTest do
  # Recordings of real firmware and definition files, damaged and cut anywhere: nothing raises, and what comes out does not
  # depend on the cuts.
  use ExUnit.Case, async: true

  alias MavCodec.Definition
  alias MavCodec.{Parser, Tlog}
  alias MavCodec.Test.Wire

  @captures Path.wildcard(Path.expand("../fixtures/captures/*.gz", __DIR__))

  setup do
    seed = :erlang.unique_integer([:positive])
    :rand.seed(:exsss, seed)
    {:ok, seed: seed, captures: Enum.map(@captures, &:zlib.gunzip(File.read!(&1)))}
  end

  defp part(data) do
    size = min(Enum.random([200, 1000, 4000]), byte_size(data))
    binary_part(data, :rand.uniform(byte_size(data) - size + 1) - 1, size)
  end

  defp damage(data), do: Enum.reduce(1..:rand.uniform(20), data, fn _, data -> damage_once(data) end)

  defp damage_once(data) do
    at = :rand.uniform(byte_size(data)) - 1
    size = min(:rand.uniform(30), byte_size(data) - at)
    <<before::binary-size(^at), there::binary-size(^size), rest::binary>> = data
    len = Enum.random([9, 40, 255])

    case :rand.uniform(6) do
      1 -> before <> rest <> "."
      2 -> before <> :rand.bytes(size) <> rest
      3 -> before <> there <> there <> rest
      4 -> before <> :binary.copy(<<Enum.random([0xFD, 0xFE])>>, size) <> there <> rest
      5 -> before <> <<0xFD, len, Enum.random([0, 1, 2, 4, 6, 8, 255]), 0>> <> there <> rest
      6 -> before <> <<0xFE, len>> <> there <> rest
    end
  end

  defp cut(<<>>), do: []

  defp cut(data) do
    size = min(:rand.uniform(Enum.random([1, 3, 40, 400, 3000])), byte_size(data))
    <<piece::binary-size(^size), rest::binary>> = data
    [piece | cut(rest)]
  end

  test "the parser", %{captures: captures, seed: seed} do
    for round <- 1..1000 do
      data = captures |> Enum.random() |> part() |> damage()

      dialects =
        Enum.random([
          [MavCodec.Dialects.All],
          [MavCodec.Dialects.Minimal],
          [MavCodec.Dialects.Upstream, MavCodec.Dialects.Ardupilot]
        ])

      options = [sysid32: Enum.random([true, false]), dialects: dialects]
      {whole, parser} = Wire.parse(data, options)
      {pieces, other} = Wire.parse(cut(data), options)
      assert {whole, Parser.stats(parser)} == {pieces, Parser.stats(other)}, "round #{round} of seed #{seed}"

      if options == [sysid32: false, dialects: [MavCodec.Dialects.All]] and
           Parser.stats(parser).incompatible == 0 do
        known = for frame <- whole, frame.crc_extra, do: frame.bytes
        assert known == Wire.scan(data), "round #{round} of seed #{seed}"
      end

      {_, parser} = Enum.flat_map_reduce(cut(data), Parser.new(options), &Parser.push_datagram(&2, &1))
      assert {_, _} = Parser.flush(parser)
      for frame <- whole, do: MavCodec.decode(frame)
    end
  end

  test "recordings", %{captures: captures} do
    tlog = Enum.zip(@captures, captures) |> Enum.find_value(fn {name, data} -> name =~ "tlog" && data end)

    for _ <- 1..500 do
      data = tlog |> part() |> damage()
      {items, decoder} = Enum.flat_map_reduce(cut(data), Tlog.Decoder.new(), &Tlog.Decoder.push(&2, &1))
      {whole, other} = Tlog.Decoder.push(Tlog.Decoder.new(), data)

      assert Enum.count(items ++ Tlog.Decoder.finish(decoder), &is_struct(&1, MavCodec.Frame)) ==
               Enum.count(whole ++ Tlog.Decoder.finish(other), &is_struct(&1, MavCodec.Frame))
    end
  end

  test "definitions" do
    xml = File.read!(Path.expand("../fixtures/definition/tiny.xml", __DIR__))

    for _ <- 1..500 do
      text = damage_once(xml)

      assert match?({:ok, _}, Definition.Importer.Parser.parse(text, "tiny.xml")) or
               match?({:error, %Definition.Error{}}, Definition.Importer.Parser.parse(text, "tiny.xml"))
    end
  end
end
