defmodule Aerie.Tool.Run.Man do
  @moduledoc "`aerie man`."
  @behaviour Aerie.Tool.Subcommand

  @impl Aerie.Tool.Subcommand
  def run(%{rows: rows}) do
    _ = Application.load(:aerie)
    {0, Aerie.Tool.Man.page(rows, to_string(Application.spec(:aerie, :vsn)))}
  end
end
