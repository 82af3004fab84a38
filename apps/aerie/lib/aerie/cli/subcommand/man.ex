defmodule Aerie.CLI.Subcommand.Man do
  @moduledoc "`aerie man`."
  @behaviour Aerie.CLI.Subcommand

  @impl Aerie.CLI.Subcommand
  def run(%{rows: rows}) do
    _ = Application.load(:aerie)
    {0, Aerie.CLI.Man.page(rows, to_string(Application.spec(:aerie, :vsn)))}
  end
end
