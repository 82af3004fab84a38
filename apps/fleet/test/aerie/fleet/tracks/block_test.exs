defmodule Aerie.Fleet.Tracks.BlockTest do
  @moduledoc "The codec of the tracks: what is written is read again, however it is cut, and nothing else is."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Tracks.{Block, Sample}

  @bounds %{
    lat: {-900_000_000, 900_000_000},
    lon: {-1_800_000_000, 1_800_000_000},
    height: {-10_000_000, 10_000_000},
    heading: {0, 359},
    speed: {-10_000_000, 10_000_000},
    age: {0, 65_535},
    battery: {0, 100},
    flags: {0, 15}
  }

  defp sample do
    numbers =
      for field <- Sample.numbers(), do: maybe(apply(:proper_types, :integer, Tuple.to_list(@bounds[field])))

    mode = maybe(:proper_types.elements(["AUTO", "RTL", "Position hold", String.duplicate("x", 32)]))

    let({numbers, mode}, fn {numbers, mode} ->
      struct!(Sample, [{:mode, mode} | Enum.zip(Sample.numbers(), numbers)])
    end)
  end

  defp maybe(type), do: :proper_types.frequency([{5, type}, {1, nil}])
  defp let(type, fun), do: :proper_types.bind(type, fun, true)

  # Ticks of some vehicles, the milliseconds between them, and whether a group begins.
  defp ticks do
    names = :proper_types.elements(["V-1", "V-2", "eagle", String.duplicate("n", 128)])

    :proper_types.non_empty(
      :proper_types.list(
        {:proper_types.integer(0, 100_000), :proper_types.boolean(),
         let(:proper_types.list({names, sample()}), &Enum.uniq_by(&1, fn {name, _sample} -> name end))}
      )
    )
  end

  defp encode(ticks) do
    {bytes, _last} =
      Enum.map_reduce(ticks, {Block.new(), 1_700_000_000_000}, fn {later, new?, samples}, {group, at} ->
        {block, group} = Block.encode(if(new?, do: Block.new(), else: group), at + later, samples)
        {block, {group, at + later}}
      end)

    IO.iodata_to_binary(bytes)
  end

  defp told(ticks) do
    {told, _at} =
      Enum.map_reduce(ticks, 1_700_000_000_000, fn {later, _new?, samples}, at ->
        {{at + later, samples}, at + later}
      end)

    told
  end

  defp read(pieces) do
    {_group, rest, found} =
      Enum.reduce(pieces, {Block.new(), "", []}, fn piece, {group, rest, found} ->
        {:ok, group, rest, found} = Block.fold(group, rest <> piece, found, &{:cont, [{&1, &2} | &3]})
        {group, rest, found}
      end)

    {rest, Enum.reverse(found)}
  end

  test "what is written is read again, wherever the bytes are split" do
    property =
      :proper.forall({ticks(), :proper_types.integer(1, 50)}, fn {ticks, size} ->
        bytes = encode(ticks)
        pieces = for <<piece::binary-size(^size) <- bytes>>, do: piece
        tail = binary_part(bytes, byte_size(bytes), -rem(byte_size(bytes), size))
        read([bytes]) == {"", told(ticks)} and read(pieces ++ [tail]) == {"", told(ticks)}
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  test "any bytes end in a result, and a damaged block in an error, with what came before it" do
    property =
      :proper.forall({ticks(), :proper_types.binary(), :proper_types.integer()}, fn {ticks, noise, at} ->
        bytes = encode(ticks)
        take = fn bytes -> Block.fold(Block.new(), bytes, [], &{:cont, [{&1, &2} | &3]}) end
        offset = Integer.mod(at, byte_size(bytes))
        <<before::binary-size(^offset), byte, behind::binary>> = bytes

        read =
          case take.(<<before::binary, Bitwise.bxor(byte, 1 + Integer.mod(at, 255)), behind::binary>>) do
            {:ok, _group, rest, found} when rest != "" -> found
            {:error, found} -> found
          end

        elem(take.(noise), 0) in [:ok, :error] and List.starts_with?(told(ticks), Enum.reverse(read))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  test "a payload that has its check sum is not believed either" do
    block = fn payload -> <<byte_size(payload)::24, :erlang.crc32(payload)::32, payload::binary>> end
    start = <<1, 5::48>>

    for payload <- [
          "",
          <<2, 1>>,
          <<3, 5::48>>,
          # A vehicle that has no name yet, a name of no bytes, one that is cut off.
          start <> <<1, 1, ?a, 0>>,
          start <> <<0, 0, 0>>,
          start <> <<0, 9, ?a>>,
          # A mask of more fields than there are, a number without an end, a word that was never written.
          start <> <<0, 1, ?a, 255, 127>>,
          start <> <<0, 1, ?a, 1, 255, 255, 255, 255, 255, 255, 1>>,
          start <> <<0, 1, ?a, 0x80, 2, 5>>
        ] do
      assert {:error, []} = Block.fold(Block.new(), block.(payload), [], &{:cont, [{&1, &2} | &3]})
    end
  end

  test "each second of a flying vehicle takes few bytes" do
    fly = fn n ->
      %Sample{
        lat: 480_000_000 + n * 900,
        lon: 110_000_000 + n * 700,
        height: 500 + rem(n, 3),
        heading: 40 + rem(n, 2)
      }
    end

    samples =
      for n <- 1..60, do: %{fly.(n) | speed: 100 + rem(n, 4), age: 0, battery: 80, flags: 3, mode: "AUTO"}

    ticks = for sample <- samples, do: {1_000, false, [{"V-1", sample}]}
    assert byte_size(encode(ticks)) < 60 * 22
  end
end
