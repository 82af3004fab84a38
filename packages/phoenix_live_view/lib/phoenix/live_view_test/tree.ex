defmodule Phoenix.LiveViewTest.Tree do
  @moduledoc false
  # The tree in the client: the diffs merged by the client's rules. Written from these rules and not
  # from `Phoenix.LiveView.Diff`, so that a mistake there is not repeated here. It works on decoded JSON.

  @type t :: map()

  @doc "The tree after a diff. Keys of the root that are not of the tree (`e`, `t`) are the caller's to take away."
  @spec merge(t(), map()) :: t() | String.t()
  def merge(_tree, %{"s" => _} = whole), do: settle(whole)
  def merge(tree, diff) when is_map(tree) and is_map(diff), do: change(tree, diff)

  # A replacement node still has to be converted to the client's form.
  defp settle(%{"k" => %{"kc" => count} = rows} = comprehension) do
    entries = for index <- indexes(count), do: rows |> Map.fetch!(Integer.to_string(index)) |> settle_entry()
    %{comprehension | "k" => entries}
  end

  defp settle(%{"s" => _} = rendered), do: Map.new(rendered, &settled/1)
  defp settle(text) when is_binary(text), do: text

  defp settle(other),
    do: raise("the client would print, or take for a component, what is not text: #{inspect(other)}")

  defp settled({"s", static}) when is_list(static), do: {"s", static}
  defp settled({"r", 1}), do: {"r", 1}
  defp settled({index, node}), do: {index, settle(node)}

  defp settle_entry(entry) when is_map(entry),
    do: Map.new(entry, fn {index, node} -> {index, settle(node)} end)

  defp change(old, new) when is_map(old) and is_map(new) do
    cond do
      is_map_key(new, "s") -> settle(new)
      is_map_key(new, "k") -> rows(old, new)
      true -> Map.merge(old, new, fn _index, before, now -> change(before, now) end)
    end
  end

  defp change(_old, %{"s" => _} = new), do: settle(new)
  defp change(_old, new) when is_binary(new), do: new

  defp change(old, new),
    do: raise("a partial node over #{inspect(old)}, which has no statics: #{inspect(new)}")

  defp rows(%{"k" => before} = old, %{"k" => %{"kc" => count} = rows}) do
    moves? = Enum.any?(rows, fn {key, row} -> key not in ["kc", "km"] and not is_map(row) end)

    if moves? != Map.get(rows, "km", false),
      do: raise("km must be there if and only if a row moved: #{inspect(rows)}")

    entries =
      for index <- indexes(count) do
        here = Enum.at(before, index)

        case Map.get(rows, Integer.to_string(index)) do
          nil -> here || raise("row #{index} is not there")
          from when is_integer(from) -> Enum.fetch!(before, from)
          [from, diff] -> before |> Enum.fetch!(from) |> entry(diff)
          diff when is_map(diff) and here == nil -> settle_entry(diff)
          diff when is_map(diff) -> entry(here, diff)
        end
      end

    Map.put(old, "k", entries)
  end

  defp rows(_old, new), do: raise("rows without kc, or over what has none: #{inspect(new)}")

  defp entry(old, diff), do: Map.merge(old, diff, fn _index, before, now -> change(before, now) end)

  defp indexes(0), do: []
  defp indexes(count), do: 0..(count - 1)

  @doc "The HTML of a tree."
  @spec html(t() | String.t()) :: iodata()
  def html(text) when is_binary(text), do: text

  def html(%{"s" => static, "k" => entries}), do: Enum.map(entries, &weave(static, &1, 0))
  def html(%{"s" => static} = rendered), do: weave(static, rendered, 0)

  defp weave([last], _nodes, _index), do: last

  defp weave([static | rest], nodes, index),
    do: [static, html(Map.fetch!(nodes, Integer.to_string(index))) | weave(rest, nodes, index + 1)]
end
