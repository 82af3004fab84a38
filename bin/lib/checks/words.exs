# Turns of phrase that read as translated, in what users see (errors, pages, help, OpenAPI, README, docs) and in comments and READMEs of
# the code. Called by bin/test; prints file, line and what to write instead.
defmodule Words do
  @banned [
    {~r/(?<!there )(?<!here )\b(is|are|was|were) no (?!longer\b|more than\b|less than\b|one\b)[a-z]+/i, "is not a ..."},
    {~r/(?<!there )\b(is|are) no $/i, "is not a ..."},
    {~r/\bby (NATS|REST)\b/, "over NATS, over REST"},
    {~r/\banew\b/i, "again, or leave it out"},
    {~r/\bceas(e|es|ed|ing)\b/i, "stop, cancel"},
    {~r/\bbelongs? into\b/i, "belongs in"},
    {~r/\bwhoever\b/i, "anyone who, or name the person"},
    {~r/\bwherefore|thereof|whereof|hitherto\b/i, "plain words"},
    {~r/\btells? of\b/i, "reports, shows"}
  ]

  def main do
    found = Enum.flat_map(code(), &(in_code(&1) ++ in_comments(&1))) ++ Enum.flat_map(pages(), &in_page/1)
    for {file, line, text, instead} <- Enum.sort(found), do: IO.puts(:stderr, "#{file}:#{line}: \"#{text}\": #{instead}")
    if found != [], do: System.halt(1)
  end

  defp code, do: Path.wildcard("apps/{mav_codec,authority,base,msp,mav_router,vehicle,mission,control,fleet,fleet_web,aerie}/lib/**/*.ex")
  defp pages, do: ["README.md", "CHANGELOG.md", "docs/openapi.json", "config/gateway.example.yaml"] ++ Path.wildcard("docs/**/*.md") ++ Path.wildcard("apps/*/*.md") ++ Path.wildcard("apps/*/lib/**/*.md")

  # Comments and documentation: lines that are not code.
  defp in_comments(file) do
    {found, _doc?} =
      file
      |> File.read!()
      |> String.split("\n")
      |> Enum.with_index(1)
      |> Enum.flat_map_reduce(false, fn {text, line}, doc? ->
        doc? = if text =~ ~r/^\s*@(module|type|)doc """/, do: true, else: doc? and not (text =~ ~r/^\s*"""/)
        {if(doc? or text =~ ~r/^\s*(#|@(module|type|)doc ")/, do: found(file, line, text), else: []), doc?}
      end)

    found
  end

  # Texts of the code.
  defp in_code(file) do
    file
    |> File.read!()
    |> Code.string_to_quoted!(literal_encoder: &{:ok, {:__block__, &2, [&1]}}, emit_warnings: false)
    |> texts()
    |> Enum.flat_map(fn {text, line} -> found(file, line, text) end)
  end

  defp texts(ast) do
    {_ast, texts} =
      Macro.prewalk(ast, [], fn
        {:@, _, [{name, _, _}]}, texts when name in [:moduledoc, :doc, :typedoc, :shortdoc] -> {nil, texts}
        {:__block__, meta, [text]} = node, texts when is_binary(text) -> {node, [{text, meta[:line]} | texts]}
        {:<<>>, meta, parts} = node, texts -> {node, for(text <- parts, is_binary(text), do: {text, meta[:line]}) ++ texts}
        node, texts -> {node, texts}
      end)

    texts
  end

  defp in_page(file) do
    for {text, line} <- file |> File.read!() |> String.split("\n") |> Enum.with_index(1), hit <- found(file, line, text), do: hit
  end

  defp found(file, line, text) do
    for {pattern, instead} <- @banned, [hit | _] <- Regex.scan(pattern, text), do: {file, line, hit, instead}
  end
end

Words.main()
