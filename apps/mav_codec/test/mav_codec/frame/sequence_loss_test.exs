defmodule MavCodec.Frame.SequenceLossTest do
  use ExUnit.Case, async: true
  import Bitwise
  alias MavCodec.Frame.SequenceLoss

  defp observe(numbers, loss \\ SequenceLoss.new()),
    do: Enum.reduce(numbers, loss, &SequenceLoss.observe(&2, &1 &&& 255))

  defp stats(numbers), do: numbers |> observe() |> SequenceLoss.stats()

  test "R7: numbers in order, over the wrap, are not a loss" do
    assert %{received: 1000, lost: 0, missing: 0, ratio: +0.0, restarts: 0} = stats(0..999)
    assert %{received: 0, lost: 0, ratio: +0.0} = stats([])
  end

  test "a run counts as its numbers one by one" do
    gap = observe([0, 1, 2, 5, 6])

    for {loss, first} <- [{SequenceLoss.new(), 250}, {gap, 7}, {gap, 9}, {gap, 100}],
        count <- [1, 2, 40, 300] do
      one_by_one = observe(first..(first + count - 1), loss)
      run = SequenceLoss.observe_run(loss, first, count)
      assert Map.drop(SequenceLoss.stats(run), [:ratio]) == Map.drop(SequenceLoss.stats(one_by_one), [:ratio])
      assert_in_delta SequenceLoss.ratio(run), SequenceLoss.ratio(one_by_one), 0.05
    end
  end

  test "a missing number is lost once it is 32 numbers old" do
    assert %{lost: 0, missing: 1} = stats([0, 1, 3])
    assert %{lost: 0, missing: 1} = stats([0, 1 | Enum.to_list(3..33)])
    assert %{lost: 1, missing: 0, late: 0} = stats([0, 1 | Enum.to_list(3..34)])
  end

  test "one of ten numbers lost is a ratio of 0.1" do
    %{ratio: ratio, lost: lost, received: received} = stats(for n <- 0..9999, rem(n, 10) != 3, do: n)
    assert_in_delta ratio, 0.1, 0.01
    assert lost in 990..1000
    assert received == 9000
  end

  test "the ratio forgets, the counters do not" do
    lossy = observe(for n <- 0..999, rem(n, 2) == 0, do: n)
    assert_in_delta SequenceLoss.ratio(lossy), 0.5, 0.05
    healed = observe(1000..2000, lossy)
    assert SequenceLoss.ratio(healed) == 0.0
    assert SequenceLoss.stats(healed).lost in 490..500
  end

  test "PX4 1.17: out of order is late, not lost" do
    numbers = Enum.to_list(0..48) ++ [50, 49, 51, 53, 54, 52] ++ Enum.to_list(55..300)
    assert %{lost: 0, missing: 0, late: 2, restarts: 0, duplicates: 0, ratio: +0.0} = stats(numbers)
  end

  test "R9: a step of 64 or more, and one backward, is a restart" do
    assert %{lost: 0, restarts: 1} = stats(Enum.to_list(0..50) ++ Enum.to_list(115..200))
    assert %{lost: 0, restarts: 1} = stats(Enum.to_list(0..150) ++ Enum.to_list(0..60))
    assert %{lost: 63, restarts: 0} = stats(Enum.to_list(0..50) ++ Enum.to_list(114..200))
  end

  test "duplicates of merged links are neither loss nor restart" do
    assert %{lost: 0, restarts: 0, duplicates: 300} = stats(Enum.flat_map(0..299, &[&1, &1]))
    assert %{lost: 0, restarts: 0} = stats(Enum.flat_map(0..299, &[&1 + 3, &1]))
  end

  describe "Betaflight: two independent counters on one source" do
    # `share` of 256 frames come from the second counter; `keep` tells which frames arrive.
    defp interleaved(a, b, share, count, keep) do
      {numbers, _} =
        Enum.map_reduce(0..(count - 1), {a, b}, fn i, {a, b} ->
          if rem(i * share, 256) < share, do: {b, {a, b + 1}}, else: {a, {a + 1, b}}
        end)

      numbers |> Enum.with_index() |> Enum.filter(fn {_, i} -> keep.(i) end) |> Enum.map(&elem(&1, 0))
    end

    test "nothing lost is nothing lost, whatever the rates and the distance" do
      for b <- [0, 1, 5, 20, 40, 63, 64, 100, 128, 200, 250], share <- [3, 20, 64, 128, 200] do
        stats = stats(interleaved(0, b, share, 4000, fn _ -> true end))
        assert stats.lost <= 100, "distance #{b}, share #{share}: #{inspect(stats)}"
        assert stats.ratio < 0.08, "distance #{b}, share #{share}: #{inspect(stats)}"
      end
    end

    test "real loss on top is about what it is" do
      for share <- [64, 128] do
        %{ratio: ratio} = stats(interleaved(0, 128, share, 8000, fn i -> rem(i * 7919, 100) >= 5 end))
        assert_in_delta ratio, 0.05, 0.04
      end
    end
  end

  test "any numbers at all keep it bounded and the counters sane" do
    numbers = for <<n <- :crypto.strong_rand_bytes(20_000)>>, do: n
    loss = observe(numbers)
    assert length(loss.tracks) <= 4
    assert length(loss.buckets) <= 8
    stats = SequenceLoss.stats(loss)
    assert stats.received == 20_000
    assert stats.ratio >= 0.0 and stats.ratio <= 1.0
  end
end
