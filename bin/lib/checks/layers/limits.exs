# The limits of bin/layers --check that have exceptions (see shrinking.exs), from the apps as Layers.Source reads them.
defmodule Layers.Limits do
  alias Layers.{Firmwares, Graph}

  @root Path.expand("../../../..", __DIR__)
  @most_files 12
  @most_named 20
  # A picture with more arrows shows nothing.
  @most_arrows 25
  @longest 120
  # What people and programs use should know the apps below by a few modules of each.
  @interfaces [:api, :console]
  @most_used 25

  def all(apps) do
    files = files("{apps,packages}/*/lib/**/*.ex")

    code =
      files("{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}") ++
        files("{test,test_kit}/**/*.{ex,exs}") ++ scripts()

    texts = Map.new(code, &{&1, File.read!(Path.join(@root, &1))})
    sources = Map.take(texts, files)

    [
      files_in_folder(files),
      named(apps),
      used(apps),
      arrows(apps),
      folder_cycles(apps),
      long_lines(texts),
      Firmwares.limit(sources)
    ]
  end

  @doc "`files` are the paths of all .ex files below a lib/."
  def files_in_folder(files) do
    %{
      name: :files_in_folder,
      most: @most_files,
      found: Enum.frequencies_by(files, &Path.dirname/1),
      problem: fn folder, n, most ->
        "#{folder}: #{n} files side by side, #{most} at most; move those of one subject to a folder of its name"
      end
    }
  end

  def named(apps) do
    %{
      name: :named_modules,
      most: @most_named,
      found:
        for(
          app <- apps,
          {file, names} <- app.names,
          into: %{},
          do: {"apps/#{app.name}/lib/#{file}.ex", length(names)}
        ),
      problem: fn file, n, most ->
        "#{file}: names #{n} modules of other files, #{most} at most; move one of its tasks to a module of its own"
      end
    }
  end

  @doc "Modules of the apps below that api and console name together. On base and access everything stands."
  def used(apps) do
    used =
      for app <- apps,
          app.name in @interfaces,
          {_file, names} <- app.names,
          {owner, module} <- names,
          owner not in [:base, :access | @interfaces],
          uniq: true,
          do: module

    %{
      name: :used_modules,
      most: @most_used,
      found: %{"apps/api, apps/console" => length(used)},
      problem: fn what, n, most ->
        "#{what}: name #{n} modules of the apps below, #{most} at most; ask one that they name already"
      end
    }
  end

  def arrows(apps) do
    %{
      name: :arrows,
      most: @most_arrows,
      found: Map.new(apps, &{"apps/#{&1.name}", length(Graph.arrows(&1.edges, &1.main))}),
      problem: fn app, n, most ->
        "#{app}: #{n} arrows between its folders, #{most} at most; join folders or remove uses"
      end
    }
  end

  @doc "No folders use each other; what is counted are the uses between those that do."
  def folder_cycles(apps) do
    cycles =
      for app <- apps,
          {folders, edges} <- Graph.folder_cycles(app.edges, app.main),
          into: %{},
          do: {"apps/#{app.name}: #{folders}", edges}

    %{
      name: :folder_cycles,
      most: 0,
      found: Map.new(cycles, fn {cycle, edges} -> {cycle, length(edges)} end),
      problem: fn cycle, n, most ->
        "#{cycle}: a cycle of folders, by #{n} uses, #{most} at most#{Graph.text(cycles[cycle])}"
      end
    }
  end

  @doc "`texts` are the files of code by their paths."
  def long_lines(texts) do
    long = for {file, text} <- texts, lines = long(text), lines != [], into: %{}, do: {file, lines}

    %{
      name: :long_lines,
      most: 0,
      found: Map.new(long, fn {file, lines} -> {file, length(lines)} end),
      problem: fn file, n, most ->
        "#{file}: #{n} lines of more than #{@longest} characters, #{most} at most; break those that are new: " <>
          Enum.join(long[file], ", ")
      end
    }
  end

  defp long(text) do
    for {line, n} <- text |> String.split("\n") |> Enum.with_index(1),
        byte_size(line) > @longest,
        String.length(line) > @longest,
        do: n
  end

  defp files(pattern),
    do: for(file <- Path.wildcard(Path.join(@root, pattern)), do: Path.relative_to(file, @root))

  defp scripts do
    for file <- files("bin/**/*"),
        File.regular?(Path.join(@root, file)),
        Path.extname(file) not in [".md", ".txt"],
        do: file
  end
end
