defmodule Phoenix.LiveViewTest.Trees do
  @moduledoc "PropEr types of rendered trees that resemble each other, as two renderings of one page do."

  alias Phoenix.LiveView.{Comprehension, Rendered}

  import :proper_types, only: [oneof: 1, range: 2, bind: 3, vector: 2]

  @doc "A page: a rendered tree of some depth."
  def tree(depth \\ 3), do: rendered(depth)

  defp map(type, fun), do: bind(type, fun, false)

  # Few different texts, so that values are often equal.
  defp text, do: oneof(["", "a", "b", "12", "&lt;"])

  defp inner(0), do: text()
  defp inner(depth), do: oneof([text(), text(), rendered(depth - 1), comprehension(depth - 1)])

  @doc "A value of a type, the same for the same seed."
  def pick(type, size, seed) do
    {:ok, value} = :proper_gen.pick(type, size, {seed, seed * 7, 11})
    value
  end

  # The number of dynamics follows from the statics, as in templates.
  defp rendered(depth) do
    bind(
      range(0, 3),
      fn shape ->
        map(vector(shape, inner(depth)), fn dynamic ->
          %Rendered{static: static(shape), dynamic: dynamic, root: shape > 0}
        end)
      end,
      false
    )
  end

  defp static(0), do: ["<hr>"]
  # Elements that may stand in each other: a browser would move others.
  defp static(1), do: ["<span>", "</span>"]
  defp static(2), do: ["<div><b>", "</b>", "</div>"]
  defp static(3), do: ["<section><i>", "</i><u>", "</u>", "</section>"]

  defp comprehension(depth) do
    row = {vector(1, inner(depth)), range(1, 6)}

    map(:proper_types.list(row), fn rows ->
      entries = rows |> Enum.uniq_by(&elem(&1, 1)) |> Enum.map(fn {dynamic, key} -> {key, dynamic} end)
      Comprehension.new(["<em>", "</em>"], entries)
    end)
  end
end
