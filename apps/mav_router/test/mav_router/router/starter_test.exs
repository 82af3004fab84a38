defmodule MavRouter.Router.StarterTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias MavRouter.Router.Starter

  # The order in which waiting vehicles are started, of rows `{key, sender, number}`.
  defp order(rows) do
    waiting = :ets.new(:waiting, [:set])
    :ets.insert(waiting, rows)

    {%{waiting: waiting}, %{}, 1}
    |> Stream.unfold(fn {tables, turns, turn} ->
      with {key, {owner, _peer}, _number} = row <- Starter.next_waiting(tables, turns) do
        :ets.delete(waiting, key)
        {row, {tables, Map.put(turns, owner, turn), turn + 1}}
      end
    end)
    |> Enum.to_list()
  end

  test "each link has its turn: the vehicles of another link do not wait behind three hundred" do
    flood = for n <- 1..300, do: {{"main", n}, {"flooded", n}, n}
    real = for n <- 301..302, do: {{"main", n}, {"quiet", :remote}, n}
    assert [1, 301, 2, 302, 3 | _] = for({_key, _sender, number} <- order(flood ++ real), do: number)
  end

  test "everybody is started once, each link's in their order" do
    property =
      :proper.forall(list(range(1, 4)), fn owners ->
        rows = for {owner, n} <- Enum.with_index(owners, 1), do: {n, {owner, :remote}, n}
        started = order(rows)

        Enum.sort(started) == rows and
          Enum.all?(1..4, fn owner ->
            numbers = for {_key, {^owner, _peer}, number} <- started, do: number
            numbers == Enum.sort(numbers)
          end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
