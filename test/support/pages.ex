defmodule Aerie.Pages do
  @moduledoc """
  The pages that a newcomer reads, and the commands that they tell to type.

  A block of commands is fenced and has no language. Where lines begin with `$ `, the others are answers. A comment above it says who runs it
  or why nobody does: `<!-- run by FILE -->`, `<!-- not run: REASON -->`.
  """

  @root Path.expand("../..", __DIR__)

  @typedoc "`mark` is the comment's text, nil without one."
  @type block :: %{page: String.t(), mark: String.t() | nil, commands: [String.t()]}

  @doc "README and everything in docs/, by their paths in the project."
  @spec all() :: [String.t()]
  def all,
    do: [
      "README.md"
      | for(path <- Path.wildcard(Path.join(@root, "docs/**/*.md")), do: Path.relative_to(path, @root))
    ]

  @doc "A page's blocks of commands."
  @spec blocks(String.t()) :: [block()]
  def blocks(page) do
    text = File.read!(Path.join(@root, page))

    for [_all, mark, body] <- Regex.scan(~r/(?:^<!-- ([^\n]+) -->\n+)?^```\n(.*?)^```$/ms, fenced(text)),
        do: %{page: page, mark: if(mark != "", do: mark), commands: commands(body)}
  end

  # Blocks with a language are left out, so that their ends are not taken for beginnings.
  defp fenced(text), do: Regex.replace(~r/^```\w+\n.*?^```$/ms, text, "")

  defp commands(body) do
    lines = body |> String.replace(~r/ *\\\n */, " ") |> String.split("\n")
    prompts? = Enum.any?(lines, &String.starts_with?(&1, "$ "))

    for line <- lines,
        not prompts? or String.starts_with?(line, "$ "),
        command =
          line |> String.replace_prefix("$ ", "") |> String.replace(~r/ +# .*/, "") |> String.trim_trailing(),
        command != "" and not String.starts_with?(command, "#"),
        do: command
  end
end
