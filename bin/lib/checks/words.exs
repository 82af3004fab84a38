# Turns of phrase that read as translated, in what users see (errors, pages, help, OpenAPI, README, docs), in comments
# and READMEs of the code, and in the names of tests. bin/test calls Words.main(), which prints file, line and what to
# write instead.
defmodule Words do
  @files [
    code: "{apps,packages}/*/lib/**/*.ex",
    test: "{apps,packages}/*/test/**/*_test.exs",
    test: "test/**/*_test.exs",
    page: "*.md",
    page: "{docs,bin,rel,test,test_kit}/**/*.md",
    page: "packages/*.md",
    page: "{apps,packages}/*/*.md",
    page: "{apps,packages}/*/{lib,priv,test,bench}/**/*.md",
    page: "docs/openapi.json",
    page: "config/gateway.example.yaml"
  ]

  @name_it "name it: the user, the gateway, the program that ..."
  # Each with a part that every match has, because most texts have none of them.
  @turns [
    {" no ",
     ~S"(?<!there )(?<!here )\b(?i:is|are|was|were) no (?!longer\b|more than\b|less than\b|one\b)([a-z]+|…)",
     "is not a ..."},
    {"by ", ~S"\bby (NATS|REST)\b", "over NATS, over REST"},
    {"new", ~S"\b(?i:anew)\b", "again, or leave it out"},
    {"eas", ~S"\b(?i:ceas(e|es|ed|ing))\b", "stop, cancel"},
    {" into", ~S"\b(?i:belongs?) into\b", "belongs in"},
    {"hoever", ~S"\b(?i:whoever)\b", "anyone who, or name the person"},
    {"her", ~S"\b(?i:wherefore|hitherto)\b", "plain words"},
    {"reof", ~S"\b(?i:thereof|whereof)\b", "plain words"},
    {" of", ~S"\b(?i:tells?) of\b", "reports, shows"},
    {" none", ~S"(?<!there )(?<!here )\b(is|are|was|were|be) none\b(?! of\b)",
     "is not one, or what it is instead"},
    {"one ", ~S"\b[Nn]one (is|are)(?=[.;,:)]|$)", "say what is not"},
    {" none", ~S"\b(told|tells?) none\b", "reported no ..."},
    {" who ",
     ~S"\b([Ff]or|[Bb]y|to|[Oo]nly|than|from|[Ww]ith|not|[Tt]hen|[Bb]ecause) who " <>
       ~S"(?!they\b|that\b|it\b|we\b|you\b)[a-z]+", "anybody who, the user who"},
    {" who ", ~S"\bof who (may|can|has|had|(?!is\b|was\b|does\b)[a-z]+s)\b",
     "of the one who, or " <> @name_it},
    {" who ", ~S"[;,:] who has it\b", "with it, anybody who has it"},
    {"Who ", ~S"(^|[.:;!?] )Who (?!is\b|was\b|has\b|does\b)[a-z]+s\b(?![^.]*\?)", @name_it},
    # With a second verb, it is a subject.
    {"ho ",
     ~S"(^|[.:;!?] )[Ww]ho (?!alone\b|they\b|that\b|it\b|we\b|you\b|the\b)[a-z]+ " <>
       ~S"((?!what|which|that|whether|how|where|if|and|or)[^ .?!,:;|()]+ ){0,9}?" <>
       ~S"(may|can|must|is|are|has|does|gets?|sees|learns|sends|needs|moves|takes|goes|keeps|counts|changes|waits) ",
     @name_it},
    {", too", ~S", too(?=[.,;:)]| \(|$)", "also, as well"},
    {"Of ", ~S"(^|[.:;!?] )Of (?!course\b)[a-z]+", "begin with the subject"},
    {" told", ~S"\b(is|are|be|being) (not |soon |then |only )?told\b(?! apart\b| otherwise\b)",
     "hears, is reported"},
    {"in time",
     ~S"(?<!point )(?<!back )(?<!answer )(?<!answered )(?<!arrive )(?<!renewed )\bin time\b(?! order\b| zone\b)",
     "before its deadline, within ... s"},
    {"mend it", ~S"\b(?i:to mend it)\b", "fix: ..."},
    {"the words say", ~S"\b(?i:does what the words say)", "say what it does"},
    {"below each", ~S"\bstands? below each other\b", "line up"},
    {"is for nobody", ~S"\bis for nobody\b", "say what is refused"}
  ]

  def main do
    patterns = patterns()

    problems =
      for({kind, wildcard} <- @files, file <- Path.wildcard(wildcard), do: {kind, file})
      |> Task.async_stream(fn {kind, file} -> {file, find(kind, File.read!(file), patterns)} end,
        timeout: :infinity
      )
      |> Enum.flat_map(fn {:ok, {file, found}} ->
        for {line, said, instead} <- found, do: "#{file}:#{line}: #{inspect(said)}: #{instead}"
      end)

    Enum.each(problems, &IO.puts(:stderr, &1))
    if problems != [], do: System.halt(1)
  end

  def patterns,
    do: for({part, pattern, instead} <- @turns, do: {part, Regex.compile!(pattern, "u"), instead})

  ## Turns of a text: `{line, what it says, what to write instead}`.

  def find(:code, text, patterns), do: text |> code() |> search(patterns)
  def find(:test, text, patterns), do: text |> names() |> search(patterns)
  def find(:page, text, patterns), do: search([{1, text}], patterns)

  defp names(text) do
    for {text, line} <- text |> String.split("\n") |> Enum.with_index(1),
        [_, name] <- [Regex.run(~r/^\s*(?:test|describe) "(.*)"/, text)],
        do: {line, name}
  end

  # Comments, documentation and texts.
  defp code(text) do
    options = [literal_encoder: &{:ok, {:__block__, &2, [&1]}}, token_metadata: true, emit_warnings: false]
    {ast, comments} = Code.string_to_quoted_with_comments!(text, options)

    {_ast, texts} =
      Macro.prewalk(ast, [], fn
        {:__block__, meta, [text]} = node, texts when is_binary(text) ->
          {node, [{line(meta), text} | texts]}

        {:<<>>, meta, parts} = node, texts ->
          {node, [{line(meta), Enum.map_join(parts, &if(is_binary(&1), do: &1, else: "…"))} | texts]}

        node, texts ->
          {node, texts}
      end)

    texts ++
      (comments |> Enum.reduce([], &comment/2) |> Enum.map(fn {first, _last, text} -> {first, text} end))
  end

  # Continues the comment of the line above, or begins one.
  defp comment(%{line: line, text: "#" <> text}, [{first, last, above} | done]) when line == last + 1,
    do: [{first, line, above <> "\n" <> text} | done]

  defp comment(%{line: line, text: "#" <> text}, done), do: [{line, line, text} | done]

  # A heredoc begins behind its delimiter.
  defp line(meta), do: if(meta[:indentation], do: meta[:line] + 1, else: meta[:line])

  defp search(texts, patterns) do
    for {line, text} <- texts, paragraph <- paragraphs(line, text), hit <- hits(paragraph, patterns), do: hit
  end

  defp hits(lines, patterns) do
    text = Enum.map_join(lines, " ", &elem(&1, 1))

    found =
      for {part, pattern, instead} <- patterns,
          String.contains?(text, part),
          [{at, length} | _] <- Regex.scan(pattern, text, return: :index),
          do: {at, {line_at(lines, at), binary_part(text, at, length), instead}}

    # Two patterns may find the same.
    for {_at, hit} <- Enum.uniq_by(found, &elem(&1, 0)), do: hit
  end

  defp line_at([{line, _text}], _at), do: line
  defp line_at([{line, text} | _lines], at) when at <= byte_size(text), do: line
  defp line_at([{_line, text} | lines], at), do: line_at(lines, at - byte_size(text) - 1)

  # Paragraphs, entries of lists and cells of tables, each as its lines.
  defp paragraphs(first, text) do
    text
    |> String.split("\n")
    |> Enum.with_index(first)
    |> Enum.reduce([[]], fn {text, line}, [lines | done] ->
      case String.trim(text) do
        "" ->
          [[], lines | done]

        "|" <> row ->
          [[] | row |> String.split("|") |> Enum.map(&[{line, String.trim(&1)}])] ++ [lines | done]

        "- " <> entry ->
          [[{line, entry}], lines | done]

        "* " <> entry ->
          [[{line, entry}], lines | done]

        "#" <> heading ->
          [[], [{line, heading |> String.trim_leading("#") |> String.trim()}], lines | done]

        text ->
          [[{line, text} | lines] | done]
      end
    end)
    |> Enum.reject(&(&1 == []))
    |> Enum.map(&Enum.reverse/1)
  end
end
