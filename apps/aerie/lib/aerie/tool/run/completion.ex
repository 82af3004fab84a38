defmodule Aerie.Tool.Run.Completion do
  @moduledoc "`aerie completion`."
  @behaviour Aerie.Tool.Subcommand

  @impl Aerie.Tool.Subcommand
  def run(%{rows: rows}), do: {0, Aerie.Tool.Completion.bash(rows)}
end
