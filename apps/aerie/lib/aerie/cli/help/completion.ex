defmodule Aerie.CLI.Help.Completion do
  @moduledoc "The completion of `aerie` for bash, made from the rows of its subcommands. Pure."

  alias Aerie.CLI.Subcommand

  @doc "A script that bash reads."
  @spec bash([Subcommand.t()]) :: String.t()
  def bash(rows) do
    """
    # Completion of aerie for bash. Made by: aerie completion
    _aerie() {
      local word=${COMP_WORDS[COMP_CWORD]} words
      case "${COMP_WORDS[1]:-} ${COMP_WORDS[2]:-}" in
    #{Enum.map_join(Enum.sort_by(rows, &(-length(String.split(&1.name)))), "\n", &options/1)}
        *) words= ;;
      esac
      [ "$COMP_CWORD" -gt 1 ] || words="#{first(rows) |> Enum.join(" ")}"
      if [ "$COMP_CWORD" = 2 ]; then
        case ${COMP_WORDS[1]} in
    #{Enum.map_join(second(rows), "\n", fn {first, words} -> "      #{first}) words=\"#{Enum.join(words, " ")}\" ;;" end)}
        esac
      fi
      COMPREPLY=($(compgen -W "$words" -- "$word"))
      [[ $word == -* ]] || [ "$COMP_CWORD" = 1 ] || COMPREPLY+=($(compgen -f -- "$word"))
    }
    complete -F _aerie aerie
    """
  end

  defp options(row) do
    names =
      for(
        {name, _kind, _placeholder, _meaning} <- row.options ++ Subcommand.common(row),
        do: Subcommand.switch(name)
      )

    words = Enum.uniq(names ++ ["--help"])
    # After one word: any word that may follow.
    pattern = if row.name =~ " ", do: ~s("#{row.name}"), else: ~s("#{row.name} "*)
    "    #{pattern}) words=\"#{Enum.join(words, " ")}\" ;;"
  end

  defp first(rows), do: rows |> Enum.map(&hd(String.split(&1.name))) |> Enum.uniq()

  defp second(rows) do
    pairs = for row <- rows, [first, second] <- [String.split(row.name)], do: {first, second}
    pairs |> Enum.group_by(&elem(&1, 0), &elem(&1, 1)) |> Enum.sort()
  end
end
