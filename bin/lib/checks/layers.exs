# Which app, folder and file uses which: checks them against the rules of design and draws them. Called by bin/layers.
#
# Apps use only apps below them, which their mix.exs names; a module's name begins with its app's. Within an app, files
# form no cycle, but for a file and those in the folder of its name: `link/core.ex` may use `link.ex`, which uses it.
# Limits with exceptions are in layers/limits.exs, what names a firmware in layers/firmwares.exs, what an app may use of
# another one in layers/readme.exs.
for file <- ~w(shrinking layers/graph layers/source layers/firmwares layers/limits layers/readme),
    do: Code.require_file("#{file}.exs", __DIR__)

defmodule Layers do
  alias Layers.{Graph, Limits, Readme, Source}

  # From the bottom up, each with how the names of its modules begin; the first one names the folder of its parts.
  @apps [
    mav_codec: ["MavCodec"],
    base: ["Aerie.Base"],
    protocols: ["Protocols"],
    msp: ["Msp"],
    mav_router: ["MavRouter"],
    vehicle: ["Aerie.Vehicle"],
    control: ["Aerie.Control"],
    fleet: ["Aerie.Fleet"],
    access: ["Aerie.Access"],
    api: ["Aerie.Api"],
    console: ["Aerie.Console"],
    aerie: ["Aerie"],
    sim_vehicle: ["SimVehicle"]
  ]
  @root Path.expand("../../..", __DIR__)
  @picture "docs/architecture.md"

  def main(["--check"]) do
    apps = read()
    limits = apps |> Limits.all() |> Enum.flat_map(&Shrinking.problems/1)
    found = Enum.flat_map(apps, &problems/1) ++ limits ++ Readme.problems(apps) ++ stale(apps)
    for problem <- found, do: IO.puts(:stderr, problem)
    if found != [], do: System.halt(1)
  end

  def main(["--draw"]), do: File.write!(picture_file(), page(read()))
  def main(["--shrink"]), do: read() |> Limits.all() |> Enum.each(&Shrinking.shrink/1)

  @doc "The apps as they are."
  def read, do: Source.read(@apps)

  @doc "What has no exceptions. An app is a map of Layers.Source."
  def problems(app) do
    names(app) ++
      directions(app) ++
      declared(app, File.read!(Path.join(@root, "apps/#{app.name}/mix.exs"))) ++ file_cycles(app) ++ told(app)
  end

  defp names(%{name: app, prefixes: prefixes, modules: modules}) do
    others =
      for {other, names} <- @apps,
          other != app,
          name <- names,
          name not in prefixes,
          Enum.any?(prefixes, &String.starts_with?(name, &1)),
          do: name

    for module <- modules,
        not String.starts_with?(module, ["Mix.Tasks.", "Inspect.", "JSON.Encoder.", "String.Chars."]),
        not named?(module, prefixes) or named?(module, others),
        do: "apps/#{app}: the module #{module} is named like one of another app"
  end

  defp named?(module, prefixes),
    do: Enum.any?(prefixes, &(module == &1 or String.starts_with?(module, &1 <> ".")))

  defp directions(%{name: app, uses: uses}) do
    above = Enum.drop_while(Keyword.keys(@apps), &(&1 != app)) -- [:sim_vehicle]
    for used <- uses, used in above, do: "apps/#{app} uses #{used}, which is above it"
  end

  @bottom [:mav_codec, :base, :protocols]

  defp told(%{name: app}) when app in @bottom do
    for file <- Path.wildcard(Path.join(@root, "apps/#{app}/lib/**/*.ex")),
        problem <- told(app, Path.relative_to(file, @root), File.read!(file)),
        do: problem
  end

  defp told(_app), do: []

  @doc "What the whole gateway stands on does not name the apps above it in documentation either."
  def told(app, file, text) do
    [_app | above] = Enum.drop_while(@apps, fn {name, _prefixes} -> name != app end)
    names = for {_app, prefixes} <- above, name <- prefixes, name != "Aerie", do: Regex.escape(name)
    named = Regex.compile!("(?<![\\w.])(#{Enum.join(names, "|")})\\.[A-Z]")

    for {line, n} <- text |> String.split("\n") |> Enum.with_index(1),
        line =~ named,
        do: "#{file}:#{n}: names a module of an app above it"
  end

  defp declared(%{name: app, uses: uses}, mix) do
    declared =
      for [_, name] <- Regex.scan(~r/\{:(\w+), in_umbrella: true(?!, only: :test)/, mix),
          {known, _prefixes} <- @apps,
          name == "#{known}",
          do: known

    for(used <- uses -- declared, do: "apps/#{app} uses #{used}, but its mix.exs does not say so") ++
      for spare <- declared -- uses, do: "apps/#{app}/mix.exs names #{spare}, which it does not use"
  end

  defp file_cycles(app),
    do:
      for(edges <- Graph.file_cycles(app.edges), do: "apps/#{app.name}: a cycle of files#{Graph.text(edges)}")

  defp stale(apps) do
    if File.read(picture_file()) == {:ok, page(apps)},
      do: [],
      else: ["#{@picture} does not show the code as it is; bin/layers --draw draws it"]
  end

  defp picture_file, do: Path.join(@root, @picture)

  defp page(apps) do
    """
    # Architecture

    Which app and which folder uses which, drawn from the code by `bin/layers --draw`. An arrow that follows from others
    is left out: where `a --> b --> c`, `a` may use `c` as well. A part without an arrow uses no other part, and none of
    them uses it. `bin/test` fails when a picture is not the code, when an app uses one above it or one that its mix.exs
    does not name, when a module's name does not say its app, and when folders or files form a cycle.

    ```mermaid
    graph TD
    #{lines(Graph.reduce(for(app <- apps, used <- app.uses, do: {app.name, used})))}
    ```

    #{Enum.map_join(apps, "\n", &picture/1)}\
    """
  end

  defp picture(app) do
    """
    ## #{app.name}

    ```mermaid
    graph TD
    #{app.edges |> Graph.arrows(app.main) |> Enum.concat(Graph.lone(app.files, app.edges, app.main)) |> lines()}
    ```
    """
  end

  defp lines(graph), do: graph |> Enum.map(&line/1) |> Enum.sort() |> Enum.join("\n")
  defp line({from, to}), do: "  #{from} --> #{to}"
  defp line(alone), do: "  #{alone}"
end
