defmodule Mix.Tasks.Aerie.Openapi do
  @shortdoc "Writes docs/openapi.json from the routes of /api"
  @moduledoc """
  Writes `docs/openapi.json` from `Aerie.Api.Rest.Routes`. Give a file name to write elsewhere.

      mix aerie.openapi [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    Mix.Task.run("app.config")
    file = List.first(args) || Path.expand("../../../../../docs/openapi.json", __DIR__)
    File.write!(file, Aerie.Api.Rest.OpenAPI.text())
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
