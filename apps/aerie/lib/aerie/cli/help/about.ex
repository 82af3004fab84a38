defmodule Aerie.CLI.Help.About do
  @moduledoc """
  `aerie version`, `aerie man` and `aerie completion`: what the program says about itself. The man page (roff) and the
  completion for bash are made from the rows of its subcommands.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.{Help, Subcommand}

  @impl Aerie.CLI.Subcommand
  def run(%{name: "version"}),
    do: {0, "aerie #{version()} (Elixir #{System.version()}, OTP #{System.otp_release()})\n"}

  def run(%{name: "man", rows: rows}), do: {0, man(rows)}
  def run(%{name: "completion", rows: rows}), do: {0, completion(rows)}

  defp version do
    _ = Application.load(:aerie)
    Application.spec(:aerie, :vsn)
  end

  defp man(rows) do
    """
    .TH AERIE 1 "" "Aerie #{version()}"
    .SH NAME
    aerie \\- gateway between MAVLink vehicles and a NATS fleet
    .SH SYNOPSIS
    .B aerie
    .I COMMAND
    .RI [ ARGUMENT ...]
    .SH COMMANDS
    #{Enum.map_join(rows, "\n", &section/1)}
    .SH ENVIRONMENT
    .TP
    .B AERIE_CONFIG
    the configuration file, unless an option names one
    .TP
    .B AERIE_HOME
    the folder in which the gateway keeps its data, in var/; names of such folders in the configuration \
    begin there, those of other files at the configuration's own folder \
    (default: the release's own)
    .TP
    .B AERIE_SHELL_DIR
    the folder by which a running gateway is found (the key shell.dir; default: var/shell)
    .PP
    Every key of the configuration can be set by the environment: AERIE_NATS_URL is nats.url.
    """
  end

  defp section(row) do
    entries = row.arguments ++ Enum.map(row.options ++ Subcommand.common(row), &Help.option/1)

    ".SS #{escape("aerie " <> Subcommand.usage(row))}\n#{escape(row.summary)}\n" <>
      Enum.map_join(Enum.uniq(entries), fn {name, meaning} ->
        ".TP\n.B #{escape(name)}\n#{escape(meaning)}\n"
      end) <>
      if(row.more, do: ".PP\n#{escape(row.more)}\n", else: "")
  end

  # A line that begins with a dot or an apostrophe is a request of roff's.
  defp escape(text) do
    text = text |> String.replace("\\", "\\e") |> String.replace("-", "\\-")
    if String.starts_with?(text, [".", "'"]), do: "\\&" <> text, else: text
  end

  defp completion(rows) do
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
    #{Enum.map_join(second(rows), "\n", &second_words/1)}
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

  defp second_words({first, words}), do: "      #{first}) words=\"#{Enum.join(words, " ")}\" ;;"

  defp first(rows), do: rows |> Enum.map(&hd(String.split(&1.name))) |> Enum.uniq()

  defp second(rows) do
    pairs = for row <- rows, [first, second] <- [String.split(row.name)], do: {first, second}
    pairs |> Enum.group_by(&elem(&1, 0), &elem(&1, 1)) |> Enum.sort()
  end
end
