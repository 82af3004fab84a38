# Graphs of files and of folders, as lists of {from, to}. A file is its path below lib/ without .ex. Pure.
#
# A folder is what lies side by side in a directory: `link/` and the `link.ex` in front of it are one.
defmodule Layers.Graph do
  @doc "Files that use each other, each cycle with its edges. A file and those in the folder of its name may."
  def file_cycles(edges) do
    edges = Enum.reject(edges, fn {from, to} -> Path.dirname(from) == to end)

    for files <- cycles(edges),
        do: for({from, to} <- Enum.sort(edges), from in files and to in files, do: {from, to})
  end

  @doc "Folders that use each other, in any directory: their names, and the edges of files between them."
  def folder_cycles(edges, main) do
    for directory <- directories(edges), folders <- cycles(folder_edges(directory, edges, main)) do
      arrows =
        for edge <- Enum.sort(edges),
            {a, b} <- [crossing(directory, edge)],
            a in folders and b in folders,
            do: edge

      {folders |> Enum.sort() |> Enum.map_join(", ", &Path.join(directory ++ [&1])), arrows}
    end
  end

  @doc "What a picture of the main directory shows."
  def arrows(edges, main), do: main |> folder_edges(edges, main) |> reduce()

  @doc "Parts of the main directory without an arrow."
  def lone(files, edges, main) do
    joined = for {from, to} <- arrows(edges, main), name <- [from, to], do: name
    for(file <- files, name = child(main, file), uniq: true, do: name) -- joined
  end

  @doc "Removes the edges that follow from others."
  def reduce(edges) do
    next = Enum.group_by(edges, &elem(&1, 0), &elem(&1, 1))

    Enum.reject(edges, fn {from, to} ->
      Enum.any?(next[from] -- [to], &reaches?(next, &1, to, MapSet.new()))
    end)
  end

  @doc "Edges of files as the lines of a problem."
  def text(edges), do: for({from, to} <- edges, into: "", do: "\n  lib/#{from}.ex -> lib/#{to}.ex")

  defp reaches?(next, from, to, seen) do
    from == to or
      Enum.any?(Map.get(next, from, []), &(&1 not in seen and reaches?(next, &1, to, MapSet.put(seen, from))))
  end

  defp cycles(edges) do
    graph = :digraph.new()
    for {from, to} <- edges, file <- [from, to], do: :digraph.add_vertex(graph, file)
    for {from, to} <- edges, do: :digraph.add_edge(graph, from, to)
    cycles = :digraph_utils.cyclic_strong_components(graph)
    :digraph.delete(graph)
    cycles
  end

  defp directories(edges) do
    for {from, to} <- edges, file <- [from, to], directory <- parents(file), uniq: true, do: directory
  end

  defp parents(file),
    do: file |> Path.split() |> Enum.drop(-1) |> Enum.scan([], &(&2 ++ [&1])) |> Enum.concat([[]])

  # In the app's main directory a file by itself counts as well: it is a part of the app like any folder.
  defp folder_edges(directory, edges, main) do
    folders =
      for {from, to} <- edges,
          file <- [from, to],
          folder?(directory, file),
          into: MapSet.new(),
          do: child(directory, file)

    counts? = fn name -> List.starts_with?(main, directory) or name in folders end

    for edge <- edges,
        {a, b} <- [crossing(directory, edge)],
        counts?.(a) and counts?.(b),
        uniq: true,
        do: {a, b}
  end

  defp folder?(directory, file),
    do: child(directory, file) != nil and length(Path.split(file)) > length(directory) + 1

  defp crossing(directory, {from, to}) do
    a = child(directory, from)
    b = child(directory, to)
    if a != nil and b != nil and a != b, do: {a, b}
  end

  # What a file belongs to within a directory.
  defp child(directory, file) do
    parts = Path.split(file)
    if List.starts_with?(parts, directory), do: Enum.at(parts, length(directory))
  end
end
