defmodule Phoenix.LiveView.Diff do
  @moduledoc """
  Computes the changes that lead the client from one rendered tree to the next. Pure.

  Nodes with equal statics are the same node, and their parts are compared; any other change sends the new node whole. Equal
  values are never sent. Rows of a comprehension are matched by their keys, so that a moved row costs only its two positions.
  A diff is computed against the tree that was last *sent*, so no change is lost if renderings are skipped.
  """

  alias Phoenix.LiveView.{Comprehension, Rendered}

  @typedoc "A value for JSON: text, or a map with the client's keys (`:s`, `:k`, positions …)."
  @type wire :: String.t() | map()

  @doc "The diff for a whole tree."
  @spec full(Rendered.tree()) :: wire()
  def full(text) when is_binary(text), do: text

  def full(%Rendered{static: static, dynamic: dynamic, root: root}) do
    wire = dynamic |> entry() |> Map.put(:s, static)
    if root, do: Map.put(wire, :r, 1), else: wire
  end

  def full(%Comprehension{static: static, entries: entries}) do
    rows = entries |> Enum.with_index() |> Map.new(fn {{_key, dynamic}, index} -> {index, entry(dynamic)} end)
    %{s: static, k: Map.put(rows, :kc, length(entries))}
  end

  @doc "The diff for the root of a page: like `full/1`, without the flag for a single root element, which has another meaning there."
  @spec root(Rendered.t()) :: map() | String.t()
  def root(%Rendered{} = rendered), do: full(%{rendered | root: false})

  @doc "The changes; an empty map if there are none."
  @spec diff(Rendered.t(), Rendered.t()) :: map() | String.t()
  def diff(%Rendered{} = previous, %Rendered{} = next) do
    case change(%{previous | root: false}, %{next | root: false}) do
      :same -> %{}
      {:changed, wire} -> wire
    end
  end

  @doc "The HTML of a tree."
  @spec to_iodata(Rendered.tree()) :: iodata()
  def to_iodata(text) when is_binary(text), do: text
  def to_iodata(%Rendered{static: static, dynamic: dynamic}), do: weave(static, dynamic)

  def to_iodata(%Comprehension{static: static, entries: entries}),
    do: Enum.map(entries, fn {_key, dynamic} -> weave(static, dynamic) end)

  defp weave([last], []), do: last
  defp weave([static | statics], [node | nodes]), do: [static, to_iodata(node) | weave(statics, nodes)]

  defp entry(dynamic),
    do: dynamic |> Enum.with_index() |> Map.new(fn {node, index} -> {index, full(node)} end)

  defp change(same, same) when is_binary(same), do: :same
  defp change(_text, text) when is_binary(text), do: {:changed, text}

  # A view may keep a part that it rendered before and give it again.
  defp change(%Rendered{static: static} = previous, %Rendered{static: static} = next) do
    if :erts_debug.same(previous, next), do: :same, else: positions(previous.dynamic, next.dynamic)
  end

  defp change(%Comprehension{static: static} = previous, %Comprehension{static: static} = next),
    do: rows(previous.entries, next.entries)

  defp change(_previous, next), do: {:changed, full(next)}

  defp positions(previous, next), do: positions(previous, next, 0, %{})

  defp positions([before | previous], [now | next], index, changes) do
    case change(before, now) do
      :same -> positions(previous, next, index + 1, changes)
      {:changed, wire} -> positions(previous, next, index + 1, Map.put(changes, index, wire))
    end
  end

  defp positions([], [], _index, changes) when changes == %{}, do: :same
  defp positions([], [], _index, changes), do: {:changed, changes}

  defp rows(same, same), do: :same

  # Usually the rows and their order are unchanged.
  defp rows(previous, next), do: in_place(previous, next, 0, %{}) || moved(previous, next)

  defp in_place([{key, before} | previous], [{key, now} | next], index, changes) do
    case positions(before, now) do
      :same -> in_place(previous, next, index + 1, changes)
      {:changed, wire} -> in_place(previous, next, index + 1, Map.put(changes, index, wire))
    end
  end

  defp in_place([], [], _count, changes) when changes == %{}, do: :same
  defp in_place([], [], count, changes), do: {:changed, %{k: Map.put(changes, :kc, count)}}
  defp in_place(_others, _than_before, _index, _changes), do: nil

  defp moved(previous, next) do
    known =
      previous |> Enum.with_index() |> Map.new(fn {{key, dynamic}, index} -> {key, {index, dynamic}} end)

    {changes, moved?, count} =
      Enum.reduce(next, {%{}, false, 0}, fn {key, dynamic}, {changes, moved?, index} ->
        case row(known, key, dynamic, index) do
          :same -> {changes, moved?, index + 1}
          {:here, wire} -> {Map.put(changes, index, wire), moved?, index + 1}
          {:moved, wire} -> {Map.put(changes, index, wire), true, index + 1}
        end
      end)

    cond do
      changes == %{} and count == map_size(known) -> :same
      moved? -> {:changed, %{k: Map.merge(changes, %{kc: count, km: true})}}
      true -> {:changed, %{k: Map.put(changes, :kc, count)}}
    end
  end

  defp row(known, key, dynamic, index) do
    case known do
      %{^key => {^index, before}} ->
        with {:changed, wire} <- positions(before, dynamic), do: {:here, wire}

      %{^key => {old, before}} ->
        case positions(before, dynamic) do
          :same -> {:moved, old}
          {:changed, wire} -> {:moved, [old, wire]}
        end

      # Whole, because the client merges it into the row that is at this position.
      _new ->
        {:here, entry(dynamic)}
    end
  end
end
