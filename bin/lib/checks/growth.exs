# How many lines each app has, and how many more than at the last release; and commits that add much code to lib and
# do not say what they delete in return. Called by bin/test. Without git or in a shallow clone, it prints what it can.
defmodule Growth do
  @root Path.expand("../../..", __DIR__)
  @files ["{apps,packages}/*/{lib,test,bench,priv}/**/*.{ex,exs,md}", "{apps,packages}/*/*.md"] ++
           ["{docs,test,test_kit,bin,rel}/**/*.{ex,exs,md}", "*.md"]
  @kinds [:lib, :tests, :bench, :docs]
  @most_added 500
  # Older commits were checked when they landed.
  @commits 200

  def main do
    IO.puts(table(@root))
    problems = problems(@root)
    for problem <- problems, do: IO.puts(:stderr, problem)
    if problems != [], do: System.halt(1)
  end

  @doc "A line for each app and package, one for all else, and their sum."
  def table(root) do
    now = now(root)
    {since, commit} = base(root) || {"no release tag", nil}
    difference = commit && difference(root, commit)
    parts = now |> Map.keys() |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()

    [row("lines (#{since})", @kinds) | Enum.map(parts, &row(&1, cells([&1], now, difference)))]
    |> Enum.concat([row("all", cells(parts, now, difference))])
    |> Enum.join("\n")
  end

  defp row(name, cells) do
    (String.pad_trailing(name, 30) <> Enum.map_join(cells, &String.pad_leading("#{&1}", 17)))
    |> String.trim_trailing()
  end

  defp cells(parts, now, difference) do
    for kind <- @kinds do
      sum = fn numbers -> parts |> Enum.map(&Map.get(numbers, {&1, kind}, 0)) |> Enum.sum() end
      text = number(sum.(now))
      if difference, do: text <> String.pad_leading(signed(sum.(difference)), 8), else: text
    end
  end

  defp signed(n) when n > 0, do: "+" <> number(n)
  defp signed(n) when n < 0, do: "-" <> number(-n)
  defp signed(0), do: ""

  defp number(n), do: n |> Integer.to_string() |> String.replace(~r/\B(?=(\d{3})+$)/, ",")

  defp now(root) do
    for pattern <- @files,
        file <- Path.wildcard(Path.join(root, pattern)),
        key = key(Path.relative_to(file, root)),
        reduce: %{} do
      sums -> add(sums, key, file |> File.read!() |> String.split("\n") |> length() |> Kernel.-(1))
    end
  end

  # New files count once git knows them.
  defp difference(root, base) do
    {:ok, text} = git(root, ~w(diff --numstat --no-renames #{base}))
    for {key, n} <- changes(text), reduce: %{}, do: (sums -> add(sums, key, n))
  end

  defp changes(numstat) do
    for [_, added, deleted, file] <- Regex.scan(~r/^(\d+)\t(\d+)\t(.+)$/m, numstat),
        key = key(file),
        do: {key, String.to_integer(added) - String.to_integer(deleted)}
  end

  defp add(sums, key, n), do: Map.update(sums, key, n, &(&1 + n))

  # What a file counts for: the part it belongs to, and the kind.
  defp key(file) do
    case {Path.split(file), Path.extname(file)} do
      # The simulator is in no release.
      {["apps", "sim_vehicle", "lib" | _], ".ex"} -> {"sim_vehicle", :tests}
      {[top, part | _], ".md"} when top in ["apps", "packages"] -> {part, :docs}
      {[top, part, folder | _], extension} when top in ["apps", "packages"] -> kind(part, folder, extension)
      {["test_kit", "bench" | _], extension} -> kind("test_kit", "bench", extension)
      {_path, ".md"} -> {"(others)", :docs}
      {[folder | _], extension} -> kind("(others)", folder, extension)
    end
  end

  defp kind(part, "lib", ".ex"), do: {part, :lib}
  defp kind(part, "test", extension) when extension in [".ex", ".exs"], do: {part, :tests}
  defp kind(part, "bench", extension) when extension in [".ex", ".exs"], do: {part, :bench}
  defp kind(_part, _folder, _extension), do: nil

  # The last release: its tag; before there is one, the commit that gave the first version its section in CHANGELOG.md.
  defp base(root) do
    case line(git(root, ~w(describe --tags --abbrev=0 --match v*))) do
      {:ok, tag} -> {"since #{tag}", tag}
      :error -> first_release(root)
    end
  end

  # In a shallow clone the first commit seems to have added everything.
  defp first_release(root) do
    section = ~w(log --first-parent --reverse --format=%h) ++ ["-S## 0.1.0", "--", "CHANGELOG.md"]

    with {:ok, "false"} <- line(git(root, ~w(rev-parse --is-shallow-repository))),
         {:ok, commit} <- line(git(root, section)) do
      {"since 0.1.0, #{commit}", commit}
    else
      _none -> nil
    end
  end

  defp line({:ok, text}) when text != "", do: {:ok, text |> String.split("\n") |> hd()}
  defp line(_nothing), do: :error

  @doc "Commits since this check exists that add more than #{@most_added} lines to lib without a line \"Deletes: \"."
  def problems(root) do
    commits = commits(root)

    for {commit, message, changes} <- commits,
        added = Enum.sum(for {{_part, :lib}, n} <- changes, do: n),
        added > @most_added,
        not (message =~ ~r/^Deletes: \S/m or named_later?(commit, commits) or in_changelog?(root, commit)) do
      title = message |> String.split("\n") |> hd()
      short = String.slice(commit, 0, 8)

      "#{short} (#{title}): adds #{added} lines to lib and does not say what it deletes in return; more than " <>
        "#{@most_added} need a line \"Deletes: …\" in the commit's message or in its change of CHANGELOG.md. " <>
        "After it has landed, a later commit says \"Deletes: … (for #{short})\""
    end
  end

  defp commits(root) do
    introduced = ~w(log --diff-filter=A --format=%H -- bin/lib/checks/growth.exs)

    since =
      ~w(log --no-merges --no-renames --numstat -n #{@commits} --format=%x00%H%x00%B%x00 --ancestry-path)

    with {:ok, text} when text != "" <- git(root, introduced),
         first = text |> String.split() |> List.last(),
         {:ok, log} <- git(root, since ++ ["#{first}..HEAD"]) do
      for [commit, message, numstat] <- log |> String.split("\0") |> tl() |> Enum.chunk_every(3),
          do: {commit, message, changes(numstat)}
    else
      _no_history -> []
    end
  end

  defp named_later?(commit, commits) do
    Enum.any?(commits, fn {_commit, message, _changes} ->
      message =~ ~r/^Deletes: .*#{String.slice(commit, 0, 8)}/m
    end)
  end

  defp in_changelog?(root, commit) do
    {:ok, text} = git(root, ~w(show --format= --unified=0 #{commit} -- CHANGELOG.md))
    text =~ ~r/^\+\W*Deletes: \S/m
  end

  defp git(root, args) do
    args = ["-C", root, "-c", "core.quotePath=off", "-c", "color.ui=off" | args]

    with git when git != nil <- System.find_executable("git"),
         {text, 0} <- System.cmd(git, args, stderr_to_stdout: true) do
      {:ok, text}
    else
      _no_git -> :error
    end
  end
end
