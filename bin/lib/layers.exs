# Which app, folder and file uses which: checks them against the rules of design and draws them. Called by bin/layers.
#
# Apps use only apps below them, which their mix.exs names; a module's name begins with its app's. Within an app, files form no
# cycle, but for a file and those in the folder of its name: `link/core.ex` may use `link.ex`, which uses it. A folder is what lies
# side by side in a directory: `link/` and the `link.ex` in front of it are one.
defmodule Layers do
  # From the bottom up, each with how the names of its modules begin.
  @apps [
    mav_codec: ["MavCodec"],
    authority: ["Authority"],
    base: ["Aerie.Base"],
    msp: ["Msp"],
    mav_router: ["MavRouter"],
    vehicle: ["Aerie.Vehicle"],
    mission: ["Aerie.Mission"],
    control: ["Aerie.Control"],
    fleet: ["Aerie.Fleet"],
    fleet_web: ["FleetWeb"],
    aerie: ["Aerie"],
    sim_vehicle: ["SimVehicle"]
  ]
  @picture "docs/architecture.md"
  # More arrows than that show nothing.
  @most_arrows 25

  def main(["--check"]) do
    apps = read()
    found = Enum.flat_map(apps, &problems(&1, apps)) ++ picture_problems(apps)
    for problem <- found, do: IO.puts(:stderr, problem)
    if found != [], do: System.halt(1)
  end

  def main(["--draw"]), do: File.write!(@picture, page(read()))

  defp read do
    owners = for {app, _prefixes} <- @apps, module <- modules(app), into: %{}, do: {module, app}

    for {app, prefixes} <- @apps do
      uses = app |> modules() |> Enum.flat_map(&used(app, &1)) |> MapSet.new(&owners[&1]) |> MapSet.delete(nil) |> MapSet.delete(app)
      %{name: app, prefixes: prefixes, edges: edges(app), uses: Enum.filter(Keyword.keys(@apps), &(&1 in uses))}
    end
  end

  # Compiled already, by the caller. Paths below lib/.
  defp edges(app) do
    dot = Path.join(System.tmp_dir!(), "layers-#{app}-#{System.pid()}.dot")
    args = ~w(xref graph --no-compile --no-deps-check --format dot --output) ++ [dot]
    {_out, 0} = System.cmd("mix", args, cd: "apps/#{app}", stderr_to_stdout: true)
    text = File.read!(dot)
    File.rm!(dot)
    for [_, from, to] <- Regex.scan(~r/"lib\/(.+)\.ex" -> "lib\/(.+)\.ex"/, text), do: {from, to}
  end

  defp modules(app) do
    for beam <- Path.wildcard("#{ebin(app)}/Elixir.*.beam"), source?(beam), do: Path.basename(beam, ".beam")
  end

  # Those of lib/, not of the tests' support.
  defp source?(beam) do
    {:ok, {_module, [compile_info: info]}} = :beam_lib.chunks(String.to_charlist(beam), [:compile_info])
    not String.contains?(to_string(info[:source]), "/test/")
  end

  defp used(app, module) do
    beam = String.to_charlist("#{ebin(app)}/#{module}.beam")
    {:ok, {_module, [atoms: atoms]}} = :beam_lib.chunks(beam, [:atoms])
    for {_index, atom} <- atoms, do: Atom.to_string(atom)
  end

  defp ebin(app), do: "_build/#{System.get_env("MIX_ENV", "test")}/lib/#{app}/ebin"

  defp problems(app, apps) do
    names(app) ++ directions(app, apps) ++ declared(app) ++ file_cycles(app) ++ folder_cycles(app)
  end

  defp names(%{name: app, prefixes: prefixes}) do
    others = for {other, names} <- @apps, other != app, name <- names, name not in prefixes, Enum.any?(prefixes, &String.starts_with?(name, &1)), do: name

    for "Elixir." <> module <- modules(app),
        not String.starts_with?(module, ["Mix.Tasks.", "Inspect.", "String.Chars."]),
        not named?(module, prefixes) or named?(module, others),
        do: "apps/#{app}: the module #{module} is named like one of another app"
  end

  defp named?(module, prefixes), do: Enum.any?(prefixes, &(module == &1 or String.starts_with?(module, &1 <> ".")))

  defp directions(%{name: app, uses: uses}, apps) do
    order = Enum.map(apps, & &1.name)
    above = Enum.drop_while(order, &(&1 != app)) -- [:sim_vehicle]
    for used <- uses, used in above, do: "apps/#{app} uses #{used}, which is above it"
  end

  defp declared(%{name: app, uses: uses}) do
    text = File.read!("apps/#{app}/mix.exs")

    declared =
      for [_, name] <- Regex.scan(~r/\{:(\w+), in_umbrella: true(?!, only: :test)/, text),
          {known, _prefixes} <- @apps,
          name == "#{known}",
          do: known

    for(used <- uses -- declared, do: "apps/#{app} uses #{used}, but its mix.exs does not say so") ++
      for spare <- declared -- uses, do: "apps/#{app}/mix.exs names #{spare}, which it does not use"
  end

  # A file and those in the folder of its name may use each other.
  defp file_cycles(%{name: app, edges: edges}) do
    edges = Enum.reject(edges, fn {from, to} -> Path.dirname(from) == to end)

    for files <- cycles(edges) do
      arrows = for {from, to} <- Enum.sort(edges), from in files and to in files, do: "\n  lib/#{from}.ex -> lib/#{to}.ex"
      "apps/#{app}: a cycle of files#{arrows}"
    end
  end

  defp folder_cycles(%{name: app, edges: edges}) do
    main = main_directory(edges)

    for directory <- directories(edges), folders <- cycles(folder_edges(directory, edges, main)) do
      arrows =
        for {from, to} <- Enum.sort(edges), pair = crossing(directory, {from, to}), elem(pair, 0) in folders and elem(pair, 1) in folders,
            do: "\n  lib/#{from}.ex -> lib/#{to}.ex"

      "apps/#{app}: a cycle of folders: #{Enum.map_join(Enum.sort(folders), ", ", &Path.join(directory ++ [&1]))}#{arrows}"
    end
  end

  defp cycles(edges) do
    graph = :digraph.new()
    for {from, to} <- edges, file <- [from, to], do: :digraph.add_vertex(graph, file)
    for {from, to} <- edges, do: :digraph.add_edge(graph, from, to)
    :digraph_utils.cyclic_strong_components(graph)
  end

  defp directories(edges) do
    for {from, to} <- edges, file <- [from, to], directory <- parents(file), uniq: true, do: directory
  end

  defp parents(file), do: file |> Path.split() |> Enum.drop(-1) |> Enum.scan([], &(&2 ++ [&1])) |> Enum.concat([[]])

  # In the app's main directory a file by itself counts too: it is a part of the app like any folder.
  defp folder_edges(directory, edges, main) do
    folders = for {from, to} <- edges, file <- [from, to], name = folder(directory, file), into: MapSet.new(), do: name
    counts? = fn name -> List.starts_with?(main, directory) or name in folders end
    for edge <- edges, {a, b} <- [crossing(directory, edge)], counts?.(a) and counts?.(b), uniq: true, do: {a, b}
  end

  defp folder(directory, file) do
    parts = Path.split(file)
    if List.starts_with?(parts, directory) and length(parts) > length(directory) + 1, do: Enum.at(parts, length(directory))
  end

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

  defp picture_problems(apps) do
    crowded =
      for app <- apps, count = length(arrows(app)), count > @most_arrows,
          do: "apps/#{app.name}: #{count} arrows between its folders; a picture shows #{@most_arrows} at most"

    stale = File.read(@picture) != {:ok, page(apps)}
    crowded ++ if(stale, do: ["#{@picture} does not show the code as it is; bin/layers --draw draws it"], else: [])
  end

  defp page(apps) do
    """
    # Architecture

    Which app and which folder uses which, drawn from the code by `bin/layers --draw`. An arrow that follows from others is left
    out: where `a --> b --> c`, `a` may use `c` too. `bin/test` fails when a picture is not the code, when an app uses one above it or one
    that its mix.exs does not name, when a module's name does not say its app, and when folders or files form a cycle.

    ```mermaid
    graph TD
    #{draw(for(app <- apps, used <- app.uses, do: {app.name, used}))}
    ```

    #{Enum.map_join(apps, "\n", &picture/1)}\
    """
  end

  defp picture(app) do
    """
    ## #{app.name}

    ```mermaid
    graph TD
    #{app |> arrows() |> lines()}
    ```
    """
  end

  defp arrows(%{edges: edges}) do
    main = main_directory(edges)
    main |> folder_edges(edges, main) |> reduce()
  end

  # The folder that holds the app's parts: lib/aerie/control, lib/fleet_web.
  defp main_directory(edges) do
    edges
    |> Enum.flat_map(&Tuple.to_list/1)
    |> Enum.reject(&String.starts_with?(&1, "mix/"))
    |> Enum.map(&(&1 |> Path.split() |> Enum.drop(-1) |> Enum.take(2)))
    |> Enum.reduce(&common/2)
  end

  defp common(a, b), do: Enum.zip(a, b) |> Enum.take_while(fn {x, y} -> x == y end) |> Enum.map(&elem(&1, 0))

  defp draw(edges), do: edges |> reduce() |> lines()
  defp lines(edges), do: edges |> Enum.sort() |> Enum.map_join("\n", fn {from, to} -> "  #{from} --> #{to}" end)

  # Without the arrows that follow from others.
  defp reduce(edges) do
    next = Enum.group_by(edges, &elem(&1, 0), &elem(&1, 1))
    Enum.reject(edges, fn {from, to} -> Enum.any?(next[from] -- [to], &reaches?(next, &1, to, MapSet.new())) end)
  end

  defp reaches?(next, from, to, seen) do
    from == to or
      Enum.any?(Map.get(next, from, []), &(&1 not in seen and reaches?(next, &1, to, MapSet.put(seen, from))))
  end
end

Layers.main(System.argv())
