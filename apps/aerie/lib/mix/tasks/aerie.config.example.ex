defmodule Mix.Tasks.Aerie.Config.Example do
  @shortdoc "Writes config/gateway.example.yaml from the schema"
  @moduledoc """
  Writes `config/gateway.example.yaml` from `Aerie.Config.Keys`. Give a file name to write elsewhere.

      mix aerie.config.example [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    file = List.first(args) || Path.expand("../../../../../config/gateway.example.yaml", __DIR__)
    File.write!(file, Aerie.Config.Example.yaml())
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
