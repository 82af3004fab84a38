defmodule MavCodec.ParserWorkTest do
  # What a parser does for each byte is bounded, whatever the bytes are. Work is counted in reductions, which are calls of
  # functions: the same on every machine. They run in a process whose heap is never collected, for that would count too.
  use ExUnit.Case, async: true

  alias MavCodec.Parser
  alias MavCodec.Test.{Hostile, TinyDialect}

  # Random bytes cost 2. Frames of 13 bytes, which are worth it, cost 8.
  @per_byte 12
  # A read has its own cost, and may cut each time a CRC of 280 bytes short of being bought in bulk.
  @per_read 1000

  defp work(fun) do
    test = self()
    run = fn -> send(test, {:work, reductions(fun)}) end
    {_pid, monitor} = :erlang.spawn_opt(run, [:monitor, min_heap_size: 12_000_000])
    assert_receive {:DOWN, ^monitor, _, _, :normal}
    assert_receive {:work, work}
    work
  end

  defp reductions(fun) do
    {:reductions, before} = Process.info(self(), :reductions)
    fun.()
    {:reductions, behind} = Process.info(self(), :reductions)
    behind - before
  end

  defp stream(parser, data, cut),
    do: data |> chunks(cut) |> Enum.reduce(parser, &elem(Parser.push(&2, &1), 1)) |> Parser.flush()

  defp datagrams(parser, data, cut),
    do: data |> chunks(cut) |> Enum.reduce(parser, &elem(Parser.push_datagram(&2, &1), 1)) |> Parser.flush()

  defp chunks(<<>>, _cut), do: []
  defp chunks(data, cut) when byte_size(data) <= cut, do: [data]

  defp chunks(data, cut) do
    <<chunk::binary-size(^cut), rest::binary>> = data
    [chunk | chunks(rest, cut)]
  end

  defp bound(data, cut), do: @per_byte * byte_size(data) + @per_read * (div(byte_size(data), cut) + 2)

  # 65,507 times 0xFE, 0.6 s, was what stopped a link.
  for {name, index} <- Hostile.all(1) |> Enum.map(&elem(&1, 0)) |> Enum.with_index() do
    test "one datagram or read of #{name}: linear" do
      {_, data} = Enum.at(Hostile.all(65_507), unquote(index))
      data = binary_part(data, 0, 65_507)

      for options <- [
            [],
            [sysid32: true],
            [dialects: [TinyDialect]],
            [dialects: [MavCodec.Dialects.All, TinyDialect]]
          ] do
        parser = Parser.new(options)
        assert work(fn -> stream(parser, data, 65_507) end) < @per_byte * 65_507
        assert work(fn -> datagrams(parser, data, 65_507) end) < @per_byte * 65_507
      end
    end
  end

  test "however it is cut" do
    parser = Parser.new()

    for {name, data} <- Hostile.all(3000), cut <- [1, 2, 5, 13, 100, 280, 1400] do
      bound = bound(data, cut)
      assert work(fn -> stream(parser, data, cut) end) < bound, "#{name}, stream, reads of #{cut}"
      assert work(fn -> datagrams(parser, data, cut) end) < bound, "#{name}, datagrams of #{cut}"
    end
  end

  # Headers that overlap, in every mix: each of these bytes is a magic, a length, a flag, an id or a zero to some other.
  test "any mix of what looks like headers" do
    byte =
      :proper_types.oneof([
        0xFE,
        0xFD,
        0xFE,
        0xFD,
        0,
        0,
        1,
        2,
        4,
        6,
        9,
        110,
        254,
        255,
        :proper_types.range(0, 255)
      ])

    pattern =
      :proper_types.bind(
        {byte, :proper_types.list(byte)},
        &:binary.list_to_bin([elem(&1, 0) | elem(&1, 1)]),
        false
      )

    mix = :proper_types.list({pattern, :proper_types.range(1, 200)})
    parser = Parser.new()

    property =
      :proper.forall({mix, :proper_types.range(1, 5000)}, fn {parts, cut} ->
        data = for({pattern, times} <- parts, do: :binary.copy(pattern, times)) |> IO.iodata_to_binary()
        bound = bound(data, cut)

        work(fn -> stream(parser, data, cut) end) < bound and
          work(fn -> datagrams(parser, data, cut) end) < bound
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 300}, {:max_size, 40}]) == true,
           inspect(:proper.counterexample())
  end
end
