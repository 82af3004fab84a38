# The configuration of ex_doc for bin/docs, which it evaluates.
#
# ex_doc knows pages by the last part of their names only, and the repository has dozens of README.md. So each page is copied under a name of
# its own, and the links between pages are changed to match. A link that leads nowhere is an error.
defmodule Docs do
  @references ~w(architecture commands logs metrics rules shadow telemetry)

  def options(output) do
    pages = pages()
    folder = Path.join(System.tmp_dir!(), "aerie-docs-#{System.pid()}")
    System.at_exit(fn _status -> File.rm_rf!(folder) end)
    File.mkdir_p!(folder)
    headings = for {source, _name, _group} <- pages, into: %{}, do: {source, headings(source)}

    {texts, broken} =
      Enum.map_reduce(pages, [], fn {source, name, _group}, broken ->
        {text, more} = linked(source, pages, headings, output)
        {{Path.join(folder, name), text}, broken ++ more}
      end)

    if broken != [] do
      Enum.each(broken, &IO.puts(:stderr, &1))
      System.halt(1)
    end

    for {path, text} <- texts, do: File.write!(path, text)

    [
      extras: for({path, _text} <- texts, do: path),
      groups_for_extras: for({group, members} <- grouped(pages), group != nil, do: {group, for({_source, name, _group} <- members, do: Path.join(folder, name))}),
      groups_for_modules: modules(),
      assets: %{"docs/img" => "img"},
      # Internals, which a README beside the code names.
      skip_code_autolink_to: ~w(Aerie.Application Circuits.UART.Core Circuits.UART.Server Gnat.init/1),
      main: "readme",
      api_reference: false
    ]
  end

  # {file, its name, its group}, in the order of the sidebar.
  defp pages do
    for pattern <- ["{README,CHANGELOG,CONTRIBUTING,SECURITY}.md", "docs/guides/*.md", "docs/*.md", "{bin,packages,test}/README.md", "test/guides/README.md", "rel/overlays/*/README.md", "{apps,packages}/*/README.md", "{apps,packages}/*/{lib,priv}/**/README.md"],
        path <- Enum.sort(Path.wildcard(pattern)),
        do: page(path, Path.split(path))
  end

  defp page(path, ["docs", file]), do: {path, file, if(Path.rootname(file) in @references, do: "Reference", else: "Guides")}
  defp page(path, ["docs", "guides", file]), do: {path, file, "Guides"}
  # docs/security.md has its name.
  defp page("SECURITY.md" = path, _split), do: {path, "reporting.md", nil}
  defp page(path, [file]), do: {path, String.downcase(file), nil}
  defp page(path, ["packages", _file]), do: {path, "packages-readme.md", "Beside the code"}
  defp page(path, folders), do: {path, Enum.join(Enum.drop(folders, -1) -- ~w(apps packages lib), "-") <> "-readme.md", "Beside the code"}

  defp grouped(pages) do
    groups = Enum.group_by(pages, &elem(&1, 2))
    for group <- ["Guides", "Reference", "Beside the code"], do: {group, groups[group]}
  end

  # Lines in code blocks are none of Markdown's.
  defp lines(source) do
    source
    |> File.read!()
    |> String.split("\n")
    |> Enum.map_reduce(false, fn line, code? ->
      fence? = String.starts_with?(String.trim_leading(line), "```")
      {{line, code? or fence?}, code? != fence?}
    end)
    |> elem(0)
  end

  defp headings(source) do
    texts = for {"#" <> _ = line, false} <- lines(source), do: line |> String.trim_leading("#") |> String.replace(~r/[`*]|\]\([^)]*\)|\[/, "") |> String.trim()
    MapSet.new(texts, &(&1 |> String.downcase() |> String.replace(~r/[^\w\s-]/u, "") |> String.replace(" ", "-")))
  end

  defp linked(source, pages, headings, output) do
    {lines, broken} =
      Enum.map_reduce(lines(source), [], fn
        {line, true}, broken ->
          {line, broken}

        {line, false}, broken ->
          links = for [_all, target] <- Regex.scan(~r/\]\(([^)\s]+)\)/, line), uniq: true, do: {target, target(target, source, pages, headings, output)}
          wrong = for {target, :error} <- links, do: "#{source}: the link to #{target} leads nowhere"
          {Enum.reduce(links, line, &replaced/2), broken ++ wrong}
      end)

    {Enum.join(lines, "\n"), broken}
  end

  defp replaced({_target, :error}, line), do: line
  defp replaced({target, to}, line), do: String.replace(line, "](#{target})", "](#{to})")

  defp target(target, source, pages, headings, output) do
    uri = URI.parse(target)
    path = uri.path && [Path.dirname(source), uri.path] |> Path.join() |> Path.expand() |> Path.relative_to_cwd()
    path = if path && File.dir?(path), do: Path.join(path, "README.md"), else: path || source

    cond do
      uri.scheme != nil -> target
      page = List.keyfind(pages, path, 0) -> anchored(uri, page, headings)
      String.starts_with?(path, "docs/img/") and File.regular?(path) -> String.replace_prefix(path, "docs/", "")
      File.regular?(path) -> copied(path, output)
      true -> :error
    end
  end

  defp anchored(%{fragment: nil}, {_source, name, _group}, _headings), do: name
  defp anchored(%{fragment: fragment} = uri, {source, name, _group}, headings) do
    if fragment in headings[source], do: "#{uri.path && name}##{fragment}", else: :error
  end

  defp copied(path, output) do
    target = Path.join([output, "files", path])
    File.mkdir_p!(Path.dirname(target))
    File.cp!(path, target)
    Path.join("files", path)
  end

  # By the app and the folder that a module's source is in.
  defp modules do
    for beam <- Path.wildcard(Path.join(System.fetch_env!("AERIE_CODE"), "lib/*/ebin/*.beam")) do
      {:ok, {module, [compile_info: info]}} = :beam_lib.chunks(String.to_charlist(beam), [:compile_info])
      {subsystem(beam, "#{info[:source]}"), module}
    end
    |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    |> Enum.sort()
  end

  defp subsystem(beam, source) do
    [_all, app] = Regex.run(~r{/lib/([^/]+)/ebin/}, beam)

    # lib/aerie/control/policy.ex and lib/aerie/api/rest/view.ex are of control: policy and api: rest.
    case Regex.run(~r{/lib/(aerie/#{app}|#{app}|aerie)/([^/.]+)(?:/|\.ex)}, source) do
      [_all, root, part] -> if File.dir?("apps/#{app}/lib/#{root}/#{part}"), do: "#{app}: #{part}", else: app
      nil -> app
    end
  end
end

Docs.options(System.fetch_env!("AERIE_DOCS"))
