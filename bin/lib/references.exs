# Names in READMEs, docs and module documentation that do not exist: modules, tests and linked files. Called by bin/test; prints file,
# line and name.
defmodule References do
  @apps ~w(Aerie MavRouter FleetWeb MavCodec SimVehicle)
  # Made from the MAVLink definitions when mav_codec is compiled.
  @generated ~r/^MavCodec\.(Messages|Enums|Dialects)\b/
  # A name of a process, without a module.
  @processes ["Aerie.CLI.Supervisor"]
  @module ~r/`((?:#{Enum.join(@apps, "|")})(?:\.[A-Z][A-Za-z0-9]*)+)/
  @test ~r/`(?:[\w.]+\/)*(\w+_test)(?:\.exs)?`/
  @file_name ~r/`((?:[\w-]+\/)*\w+\.exs?)`/
  @link ~r/\]\(([^)#: ]+)(?:#[^)]*)?\)/

  def main do
    sources = Path.wildcard("{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}") ++ Path.wildcard("{test,bin}/**/*.{ex,exs}")
    known = %{modules: sources |> Enum.flat_map(&modules/1) |> MapSet.new(), tests: MapSet.new(sources, &Path.basename(&1, ".exs")), sources: sources}
    pages = Path.wildcard("*.md") ++ Path.wildcard("{docs,bin,rel,test}/**/*.md") ++ Path.wildcard("apps/*/*.md") ++ Path.wildcard("apps/*/{lib,priv,test}/**/*.md")

    missing = Enum.flat_map(sources, &missing(&1, [module: @module], known)) ++ Enum.flat_map(pages, &missing(&1, [module: @module, test: @test, file: @file_name, link: @link], known))
    for {file, line, name} <- Enum.sort(missing), do: IO.puts(:stderr, "#{file}:#{line}: #{name} does not exist")
    if missing != [], do: System.halt(1)
  end

  defp modules(file) do
    text = File.read!(file)
    defined = Regex.scan(~r/def(?:module|protocol) ([A-Z][\w.]+)/, text, capture: :all_but_first)
    for [name] <- defined, parts = String.split(name, "."), n <- 1..length(parts), do: parts |> Enum.take(n) |> Enum.join(".")
  end

  defp missing(file, patterns, known) do
    for {text, line} <- file |> File.read!() |> String.split("\n") |> Enum.with_index(1),
        {kind, pattern} <- patterns,
        [_match, name] <- Regex.scan(pattern, text),
        not known?(kind, name, file, known),
        do: {file, line, name}
  end

  defp known?(:module, name, _file, known), do: name in @processes or name =~ @generated or MapSet.member?(known.modules, name)
  # MAV_CMD has a command of such a name.
  defp known?(:test, "motor_test", _file, _known), do: true
  defp known?(:test, name, _file, known), do: MapSet.member?(known.tests, name)
  # A name of CONTRIBUTING's examples.
  defp known?(:file, name, file, known), do: name =~ "NAME" or Enum.any?(known.sources, &String.ends_with?(&1, "/" <> name)) or exists?(file, name)
  defp known?(:link, name, file, _known), do: exists?(file, name)

  # Beside the page, in its app, or from the root.
  defp exists?(file, name) do
    app = file |> Path.split() |> Enum.take(2) |> Path.join()
    Enum.any?([Path.dirname(file), app, "."], &File.exists?(Path.join(&1, name)))
  end
end

References.main()
