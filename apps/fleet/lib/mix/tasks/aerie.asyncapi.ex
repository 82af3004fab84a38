defmodule Mix.Tasks.Aerie.Asyncapi do
  @shortdoc "Writes docs/asyncapi.json from the tables of what goes over NATS"
  @moduledoc """
  Writes `docs/asyncapi.json` from `Aerie.Fleet.AsyncAPI`. Give a file name to write elsewhere.

      mix aerie.asyncapi [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    Mix.Task.run("app.config")
    file = List.first(args) || Path.expand("../../../../../docs/asyncapi.json", __DIR__)
    File.write!(file, Aerie.Fleet.AsyncAPI.text())
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
