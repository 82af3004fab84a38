defmodule Mix.Tasks.Aerie.Help do
  @shortdoc "Writes bin/lib/help.txt from the table of subcommands"
  @moduledoc """
  Writes `bin/lib/help.txt`, from which `bin/run --help` and `bin/aerie --help` answer before anything is compiled.

      mix aerie.help [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    file = List.first(args) || Path.expand("../../../../../bin/lib/help.txt", __DIR__)
    File.write!(file, Aerie.CLI.Help.file(Aerie.CLI.Subcommands.all()))
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
