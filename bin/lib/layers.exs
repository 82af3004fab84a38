# Which folder uses which, in each app, and whether the folders form a cycle. Called by bin/layers.
#
# A folder is what lies side by side in a directory: `link/` and the `link.ex` in front of it are one. Directories are
# looked at on every level.
defmodule Layers do
  @apps ~w(mav_codec mav_router vehicle fleet_web aerie sim_vehicle)
  @picture "docs/architecture.md"

  def main(["--check"]) do
    apps = read()
    cycles = for {app, edges} <- apps, cycle <- cycles(edges), do: {app, cycle}
    for {app, {folders, edges}} <- cycles, do: tell(app, folders, edges)
    stale = File.read(@picture) != {:ok, page(apps)}
    if stale, do: IO.puts(:stderr, "#{@picture} does not show the code as it is; bin/layers --draw draws it")
    if cycles != [] or stale, do: System.halt(1)
  end

  def main(["--draw"]), do: File.write!(@picture, page(read()))

  # {app, [{from_file, to_file}]}, paths below lib/.
  defp read do
    for app <- @apps, File.dir?("apps/#{app}/lib") do
      dot = Path.join(System.tmp_dir!(), "layers-#{app}-#{System.pid()}.dot")

      # It is compiled already, by who calls this.
      args = ~w(xref graph --no-compile --no-deps-check --format dot --output #{dot})
      {_out, 0} = System.cmd("mix", args, cd: "apps/#{app}", stderr_to_stdout: true)

      text = File.read!(dot)
      File.rm!(dot)
      {app, for([_, from, to] <- Regex.scan(~r/"lib\/(.+)\.ex" -> "lib\/(.+)\.ex"/, text), do: {from, to})}
    end
  end

  # The cycles among the folders of every directory: {folders, edges between them}.
  defp cycles(edges) do
    for directory <- directories(edges), found <- cycles_in(directory, edges), do: found
  end

  defp directories(edges) do
    for({from, to} <- edges, file <- [from, to], directory <- parents(file), uniq: true, do: directory)
  end

  defp parents(file) do
    file |> Path.split() |> Enum.drop(-1) |> Enum.scan([], &(&2 ++ [&1])) |> Enum.concat([[]])
  end

  defp cycles_in(directory, edges) do
    graph = :digraph.new()
    between = for edge <- edges, pair = crossing(directory, edge, edges), do: {pair, edge}
    for {{from, to}, _edge} <- between, folder <- [from, to], do: :digraph.add_vertex(graph, folder)
    for {{from, to}, _edge} <- between, do: :digraph.add_edge(graph, from, to)

    for folders <- :digraph_utils.cyclic_strong_components(graph) do
      {Enum.map(folders, &Path.join(directory ++ [&1])),
       for({{from, to}, edge} <- between, from in folders and to in folders, do: edge)}
    end
  end

  defp crossing(directory, {from, to}, edges) do
    with a when a != nil <- child(directory, from),
         b when b != nil and a != b <- child(directory, to),
         true <- folder?(directory, a, edges) and folder?(directory, b, edges),
         do: {a, b},
         else: (_same -> nil)
  end

  # What a file belongs to within a directory.
  defp child(directory, file) do
    parts = Path.split(file)
    if List.starts_with?(parts, directory), do: Enum.at(parts, length(directory))
  end

  # In the top directory a file by itself counts too: it is a part of the app like any folder.
  defp folder?(directory, _child, _edges) when length(directory) <= 1, do: true

  defp folder?(directory, child, edges) do
    path = directory ++ [child]
    Enum.any?(edges, fn {from, to} -> Enum.any?([from, to], &below?(&1, path)) end)
  end

  defp below?(file, path), do: List.starts_with?(Path.split(file), path) and file != Path.join(path)

  # One picture for each app: its folders, and an arrow from each to those that it uses.
  defp page(apps) do
    """
    # Architecture

    Which folder uses which, drawn from the code by `bin/layers --draw`; `bin/test` fails when the picture is not the code, or
    when folders form a cycle. An app may use those below it, never those above: Mix knows no other dependencies.

    ```mermaid
    graph TD
    #{Enum.map_join(app_edges(apps), "\n", fn {from, to} -> "  #{from} --> #{to}" end)}
    ```

    #{Enum.map_join(apps, "\n", &picture/1)}\
    """
  end

  defp app_edges(apps) do
    for {app, _edges} <- apps,
        [_, used] <- Regex.scan(~r/\{:(\w+), in_umbrella: true(?!, only: :test)/, File.read!("apps/#{app}/mix.exs")),
        do: {app, used}
  end

  defp picture({app, edges}) do
    top = edges |> Enum.flat_map(&Tuple.to_list/1) |> Enum.map(&hd(Path.split(&1))) |> Enum.frequencies()
    {root, _files} = Enum.max_by(top, &elem(&1, 1))
    arrows = for edge <- edges, pair = crossing([root], edge, edges), uniq: true, do: pair

    """
    ## #{app}

    ```mermaid
    graph TD
    #{arrows |> Enum.sort() |> Enum.map_join("\n", fn {from, to} -> "  #{from} --> #{to}" end)}
    ```
    """
  end

  defp tell(app, folders, edges) do
    IO.puts(:stderr, "apps/#{app}: a cycle of folders: #{Enum.join(Enum.sort(folders), ", ")}")
    for {from, to} <- Enum.sort(edges), do: IO.puts(:stderr, "  lib/#{from}.ex -> lib/#{to}.ex")
  end
end

Layers.main(System.argv())
