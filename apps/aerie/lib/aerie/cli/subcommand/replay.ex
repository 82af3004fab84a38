defmodule Aerie.CLI.Subcommand.Replay do
  @moduledoc "`aerie replay`: the events of a recording, without a gateway (`Aerie.CLI.ReplayEvents`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.{Options, ReplayEvents}
  alias Aerie.CLI.Subcommand

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"FILE" => file}, options: options, folder: folder} = request) do
    {:ok, _started} = Application.ensure_all_started(:fleet)
    what = if options[:samples], do: [:events, :samples], else: [:events]

    # FILE is the recording here, not the configuration.
    config = Subcommand.Config.file(%{request | arguments: %{}})

    with :ok <- ReplayEvents.print(%Options{replay: file, print: what, config: config}, folder), do: {0, ""}
  end
end
