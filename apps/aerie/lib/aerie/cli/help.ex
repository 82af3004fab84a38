defmodule Aerie.CLI.Help do
  @moduledoc "The text of `--help`, of all subcommands or of one. Pure."

  alias Aerie.CLI.Subcommand

  @width 100

  @doc """
  The file from which `bin/lib/help.sh` answers `--help` in a checkout where nothing is compiled yet: the help of all
  subcommands, of each group, and of each one, below a line with its name.
  """
  @spec file([Subcommand.t()]) :: String.t()
  def file(rows) do
    groups = for row <- rows, [first, _second] <- [String.split(row.name)], uniq: true, do: first

    sections =
      [{"(all)", rows}] ++
        for(group <- groups, do: {group, Enum.filter(rows, &String.starts_with?(&1.name, group <> " "))}) ++
        for row <- rows, do: {row.name, row}

    Enum.map_join(sections, fn {name, shown} -> "@ #{name}\n#{text(shown)}" end)
  end

  @doc "The help of one subcommand, or of all."
  @spec text(Subcommand.t() | [Subcommand.t()]) :: String.t()
  def text(rows) when is_list(rows) do
    width = rows |> Enum.map(&String.length(&1.name)) |> Enum.max()

    """
    usage: aerie COMMAND [ARGUMENT ...]

    #{Enum.map_join(rows, "\n", &entry(&1.name, &1.summary, width))}

    aerie COMMAND --help explains one command.
    """
  end

  def text(%Subcommand{} = row) do
    common = Enum.reject(Subcommand.common(row), &(&1 in row.options))
    options = row.options ++ common ++ [{:help, :boolean, nil, "print this text"}]

    sections = [
      section(row.arguments, fn {name, meaning} -> {name, meaning} end),
      section(options, &option/1),
      if(row.more, do: "\n" <> fold(row.more, 2) <> "\n", else: ""),
      terms(row.terms)
    ]

    "usage: aerie #{Subcommand.usage(row)}\n\n#{fold(capital(row.summary) <> ".", 2)}\n#{sections}"
  end

  @doc "An option's words and meaning, for help and man page."
  @spec option(Subcommand.option()) :: {String.t(), String.t()}
  def option({name, :boolean, _none, meaning}), do: {Subcommand.switch(name), meaning}

  def option({name, :keep, placeholder, meaning}),
    do: option({name, :string, placeholder, meaning <> " (may be repeated)"})

  def option({name, _kind, placeholder, meaning}), do: {"#{Subcommand.switch(name)} #{placeholder}", meaning}

  defp terms(nil), do: ""
  defp terms({title, words}), do: "\n  #{title}\n" <> section(words, & &1)

  defp section([], _fun), do: ""

  defp section(list, fun) do
    entries = Enum.map(list, fun)
    width = entries |> Enum.map(&String.length(elem(&1, 0))) |> Enum.max()
    "\n" <> Enum.map_join(entries, "\n", fn {name, meaning} -> entry(name, meaning, width) end) <> "\n"
  end

  defp entry(name, meaning, width) do
    [first | rest] = wrap(meaning, @width - width - 4)
    indent = "\n" <> String.duplicate(" ", width + 4)
    "  #{String.pad_trailing(name, width)}  #{Enum.join([first | rest], indent)}"
  end

  defp fold(text, indent) do
    spaces = String.duplicate(" ", indent)
    text |> wrap(@width - indent) |> Enum.map_join("\n", &(spaces <> &1))
  end

  defp wrap(text, width) do
    text
    |> String.split()
    |> Enum.reduce([""], fn
      word, [""] ->
        [word]

      word, [line | lines] ->
        if String.length(line) + String.length(word) < width,
          do: ["#{line} #{word}" | lines],
          else: [word, line | lines]
    end)
    |> Enum.reverse()
  end

  defp capital(text), do: String.capitalize(String.first(text)) <> String.slice(text, 1..-1//1)
end
