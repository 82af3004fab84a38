defmodule Aerie.CLI.Help.Man do
  @moduledoc "The man page of `aerie`, made from the rows of its subcommands. Pure."

  alias Aerie.CLI.{Help, Subcommand}

  @doc "The page, as roff."
  @spec page([Subcommand.t()], version :: String.t()) :: String.t()
  def page(rows, version) do
    """
    .TH AERIE 1 "" "Aerie #{version}"
    .SH NAME
    aerie \\- gateway between MAVLink vehicles and a NATS fleet
    .SH SYNOPSIS
    .B aerie
    .I COMMAND
    .RI [ ARGUMENT ...]
    .SH COMMANDS
    #{Enum.map_join(rows, "\n", &row/1)}
    .SH ENVIRONMENT
    .TP
    .B AERIE_CONFIG
    the configuration file, unless an option names one
    .TP
    .B AERIE_HOME
    the folder in which the gateway keeps its data, in var/; names of such folders in the configuration begin there, those of other files at the configuration's own folder (default: the release's own)
    .TP
    .B AERIE_SHELL_DIR
    the folder by which a running gateway is found (the key shell.dir; default: var/shell)
    .PP
    Every key of the configuration can be set by the environment: AERIE_NATS_URL is nats.url.
    """
  end

  defp row(row) do
    entries = Enum.map(row.arguments, & &1) ++ Enum.map(row.options ++ Subcommand.common(row), &Help.option/1)

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
end
