defmodule Mix.Tasks.Aerie.Telemetry do
  @shortdoc "Writes docs/telemetry.md from the tables of fields and events"
  @moduledoc """
  Writes `docs/telemetry.md` from `Aerie.Vehicle.State.Fields` and `Aerie.Vehicle.Event.Types`. Give a file name to write elsewhere.

      mix aerie.telemetry [FILE]
  """
  use Mix.Task

  @impl Mix.Task
  def run(args) do
    file = List.first(args) || Path.expand("../../../../../docs/telemetry.md", __DIR__)
    File.write!(file, Aerie.Vehicle.Snapshot.Page.markdown())
    Mix.shell().info("wrote #{Path.relative_to_cwd(file)}")
  end
end
