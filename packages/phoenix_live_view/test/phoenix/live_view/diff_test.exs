defmodule Phoenix.LiveView.DiffTest do
  use ExUnit.Case, async: true

  alias Phoenix.LiveView.{Comprehension, Diff, Rendered}
  alias Phoenix.LiveViewTest.{Tree, Trees}

  defp holds(property, tests),
    do: assert(:proper.quickcheck(property, [:quiet, {:numtests, tests}, {:max_size, 40}]) == true)

  defp forall(type, fun), do: :proper.forall(type, fun)
  defp wire(value), do: value |> JSON.encode!() |> JSON.decode!()
  defp html(tree), do: tree |> Diff.to_iodata() |> IO.iodata_to_binary()
  defp client(tree), do: tree |> Tree.html() |> IO.iodata_to_binary()

  test "the client's tree after a diff is the new page, from any page to any other" do
    holds(
      forall({Trees.tree(), Trees.tree()}, fn {a, b} ->
        tree = Tree.merge(%{}, wire(Diff.root(a)))
        client(tree) == html(a) and client(Tree.merge(tree, wire(Diff.diff(a, b)))) == html(b)
      end),
      2_000
    )
  end

  test "an equal page gives no diff" do
    holds(forall(Trees.tree(), fn a -> Diff.diff(a, a) == %{} end), 500)
  end

  defp list(rows),
    do: %Rendered{static: ["<ul>", "</ul>"], dynamic: [Comprehension.new(["<li>", "</li>"], rows)]}

  defp rows(keys), do: for(key <- keys, do: {key, ["#{key}"]})

  # Table of what a change of a keyed list costs.
  for {name, before, now, expected} <- [
        {"append", [1], [1, 2], %{1 => %{0 => "2"}, :kc => 2}},
        {"shrink", [1, 2], [1], %{kc: 1}},
        {"empty", [1, 2], [], %{kc: 0}},
        {"prepend", [1, 2], [0, 1, 2], %{0 => %{0 => "0"}, 1 => 0, 2 => 1, :kc => 3, :km => true}},
        {"swap", [1, 2, 3], [3, 2, 1], %{0 => 2, 2 => 0, :kc => 3, :km => true}},
        {"replace", [1, 2], [1, 9], %{1 => %{0 => "9"}, :kc => 2}}
      ] do
    test "rows: #{name}" do
      diff = Diff.diff(list(rows(unquote(before))), list(rows(unquote(now))))
      assert diff == %{0 => %{k: unquote(Macro.escape(expected))}}
    end
  end

  test "a row that moved and changed is sent once" do
    before = list([{:a, ["1"]}, {:b, ["2"]}])
    now = list([{:b, ["3"]}, {:a, ["1"]}])
    assert Diff.diff(before, now) == %{0 => %{k: %{0 => [1, %{0 => "3"}], 1 => 0, :kc => 2, :km => true}}}
  end

  test "the flag of a single root is on inner nodes and never at the root" do
    inner = %Rendered{static: ["<b>", "</b>"], dynamic: ["x"], root: true}
    page = %Rendered{static: ["<p>", "</p>"], dynamic: [inner], root: true}
    assert %{0 => %{r: 1}} = whole = Diff.root(page)
    refute is_map_key(whole, :r)
    refute is_map_key(Diff.diff(page, %{page | static: ["<i>", "</i>"]}), :r)
  end

  # Mistakes that a diff could have, made on purpose: the tests above would notice each of them.
  describe "the property fails when" do
    for {name, mutation} <- [
          {"a list has no length", :no_count},
          {"moves are not announced", :no_moves},
          {"a row comes from another place", :other_row},
          {"a new node has no statics", :no_statics},
          {"a changed position is left out", :lost},
          {"a text is an older one", :stale}
        ] do
      test name do
        found =
          Enum.any?(1..3_000, fn seed ->
            {a, b} = Trees.pick({Trees.tree(), Trees.tree()}, 20, seed)
            diff = wire(Diff.diff(a, b))
            wrong = mutated(diff, unquote(mutation))
            wrong != diff and noticed?(a, b, wrong)
          end)

        assert found
      end
    end
  end

  defp noticed?(a, b, diff) do
    %{} |> Tree.merge(wire(Diff.root(a))) |> Tree.merge(diff) |> client() != html(b)
  rescue
    _error -> true
  end

  defp mutated(%{"kc" => _} = rows, :no_count), do: Map.delete(rows, "kc")
  defp mutated(%{"km" => _} = rows, :no_moves), do: Map.delete(rows, "km")
  defp mutated(%{"s" => _} = node, :no_statics), do: Map.delete(node, "s")
  defp mutated(%{"0" => _, "1" => _} = node, :lost), do: Map.delete(node, "1")
  defp mutated("12", :stale), do: "a"

  defp mutated(%{"km" => true, "kc" => count} = rows, :other_row) do
    Map.new(rows, fn
      {key, from} when key not in ["kc", "km"] and is_integer(from) -> {key, rem(from + 1, count)}
      row -> row
    end)
  end

  defp mutated(node, mutation) when is_map(node),
    do: Map.new(node, fn {key, inner} -> {key, mutated(inner, mutation)} end)

  defp mutated(other, _mutation), do: other
end
