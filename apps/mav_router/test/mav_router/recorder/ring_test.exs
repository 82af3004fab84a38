defmodule MavRouter.Recorder.RingTest do
  use ExUnit.Case, async: true
  use Aerie.RecorderCase

  alias MavRouter.Recorder.{Ring, Settings, Tables}
  alias MavCodec.Tlog

  @key {"main", 1}

  setup do
    :ok = Aerie.Base.Names.register(gateway = make_ref(), :recorder, nil)
    settings = %{Settings.from(%{}) | ring_ms: 1000, ring_bytes: 20_000, ring_total: 100_000}
    {:ok, tables: Tables.create(gateway, settings), settings: settings}
  end

  defp push(c, key, frames, now), do: Ring.push(c.tables, c.settings, key, frames, now)

  defp numbers(c, key) do
    bytes = for {_n, records, _frames} <- Ring.entries(c.tables, key), into: "", do: records
    {frames, decoder} = Tlog.Decoder.push(Tlog.Decoder.new(), bytes)
    for %MavCodec.Frame{} = frame <- frames ++ Tlog.Decoder.finish(decoder), do: number(frame)
  end

  test "keeps what came last, in order, by age", c do
    for n <- 1..20, do: push(c, @key, attitudes(1, n..n), n * 100)
    assert numbers(c, @key) == Enum.to_list(10..20)
    assert %{entries: 11} = Ring.size(c.tables, @key)
    assert Ring.known?(c.tables, @key)
    refute Ring.known?(c.tables, {"main", 2})
    assert Ring.size(c.tables, {"main", 2}) == nil
  end

  test "a vehicle that is forgotten meanwhile is in the sizes whole or not at all", c do
    comes_and_goes = fn again ->
      push(c, @key, attitudes(1, 1..1), 1)
      Ring.forget(c.tables, @key)
      again.(again)
    end

    start_supervised!({Task, fn -> comes_and_goes.(comes_and_goes) end})

    for _look <- 1..5_000, {_key, size} <- Ring.sizes(c.tables) do
      assert %{bytes: bytes, entries: _} = size
      assert bytes > 0
    end
  end

  test "a writer goes on while the vehicle is forgotten", c do
    forgets = fn again ->
      Enum.sum(1..:rand.uniform(1_000))
      Ring.forget(c.tables, @key)
      again.(again)
    end

    start_supervised!({Task, fn -> forgets.(forgets) end})
    # Old entries, so that each is trimmed by the next.
    for n <- 1..20_000, do: push(c, @key, attitudes(1, 1..1), n * 100_000)
  end

  defp total(tables), do: tables.rings |> :ets.tab2list() |> Enum.sum_by(fn {_key, _n, bytes} -> bytes end)

  test "is bounded by bytes, whatever the batches", c do
    for n <- 1..500, do: push(c, @key, attitudes(1, (n * 3)..(n * 3 + 2)), 1)
    assert %{bytes: bytes} = Ring.size(c.tables, @key)
    assert bytes <= 20_000 and bytes > 19_000
    assert List.last(numbers(c, @key)) == 1502
    assert total(c.tables) == bytes
  end

  test "many vehicles share", c do
    for system <- 1..20, n <- 1..200, do: push(c, {"main", system}, attitudes(system, n..n), 1)
    # Once more, now that all are there.
    for system <- 1..20, do: push(c, {"main", system}, attitudes(system, 201..201), 1)
    assert total(c.tables) <= 100_000
    for system <- 1..20, do: assert(length(numbers(c, {"main", system})) in 10..25)
    Ring.forget(c.tables, {"main", 3})
    assert Ring.entries(c.tables, {"main", 3}) == []
    assert Ring.entries(c.tables, {"main", 4}) != []
  end

  test "S9: no key and no signature is in it", c do
    key = :crypto.hash(:sha256, "secret")
    setup = frame(MavCodec.encode(%MavCodec.Messages.SetupSigning{secret_key: key}, system: 255), 5)
    {signed, _} = MavCodec.Signing.sign(MavCodec.Signing.new(key), attitude(1, 7), 39)
    push(c, @key, [setup, frame(signed, 6)], 1)
    [{1, records, 2}] = Ring.entries(c.tables, @key)
    assert :binary.match(records, key) == :nomatch
    {[_setup, frame], _} = Tlog.Decoder.push(Tlog.Decoder.new(), records)
    assert frame.signature == nil
    assert frame.bytes == attitude(1, 7)
  end

  test "several write at once: nothing is counted that is not there", c do
    1..8
    |> Task.async_stream(fn task -> for n <- 1..300, do: push(c, @key, attitudes(1, n..n), task) end,
      timeout: Aerie.Patience.ms()
    )
    |> Stream.run()

    sizes = :ets.select(c.tables.ring, [{{{@key, :_}, :_, :"$1", :_, :_}, [], [:"$1"]}])
    assert Ring.size(c.tables, @key).bytes == Enum.sum(sizes)
    assert Enum.sum(sizes) <= 20_000
  end
end
