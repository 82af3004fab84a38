defmodule Aerie.CLI.Subcommand.Completion do
  @moduledoc "`aerie completion`."
  @behaviour Aerie.CLI.Subcommand

  @impl Aerie.CLI.Subcommand
  def run(%{rows: rows}), do: {0, Aerie.CLI.Completion.bash(rows)}
end
