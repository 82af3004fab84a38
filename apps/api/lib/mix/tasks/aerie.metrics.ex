defmodule Mix.Tasks.Aerie.Metrics do
  @shortdoc "Writes docs/metrics.md from the families of /metrics"
  @moduledoc """
  Writes `docs/metrics.md` from `Aerie.Api.Metrics`. Give a file name to write elsewhere.

      mix aerie.metrics [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    Mix.Task.run("app.start")
    file = List.first(args) || Path.expand("../../../../../docs/metrics.md", __DIR__)
    File.write!(file, Aerie.Api.Metrics.Page.markdown())
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
