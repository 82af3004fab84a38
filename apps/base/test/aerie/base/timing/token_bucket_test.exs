defmodule Aerie.Base.Timing.TokenBucketTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Timing.TokenBucket

  defp take(full, times, keep \\ 0) do
    Enum.flat_map_reduce(times, full, fn now, full ->
      case TokenBucket.take(full, now, 10, 5, keep) do
        {:ok, full} -> {[now], full}
        :none -> {[], full}
      end
    end)
  end

  test "so many at once, then one in each interval, and all of them again after a rest" do
    {got, full} = take(nil, List.duplicate(0, 20) ++ Enum.to_list(1..100))
    assert Enum.count(got, &(&1 == 0)) == 5
    assert got -- List.duplicate(0, 5) == Enum.to_list(10..100//10)
    assert {[_, _, _, _, _], _} = take(full, List.duplicate(1000, 9))
  end

  test "what is kept is there for others" do
    {got, full} = take(nil, List.duplicate(0, 9), 3)
    assert length(got) == 2
    assert {[0, 0, 0], _} = take(full, List.duplicate(0, 9))
  end
end
