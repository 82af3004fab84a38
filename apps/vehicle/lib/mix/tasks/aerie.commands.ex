defmodule Mix.Tasks.Aerie.Commands do
  @shortdoc "Renews the tables of docs/commands.md"
  @moduledoc """
  Renews the tables of `docs/commands.md` from the table of commands (`Aerie.Vehicle.Command.Types`) and the gaps of the firmwares
  (`Aerie.Vehicle.Protocol`).

      mix aerie.commands
  """
  use Mix.Task

  @page Path.expand("../../../../../docs/commands.md", __DIR__)

  @doc "The page as it is to be."
  @spec page() :: String.t()
  def page do
    sections = Map.merge(Aerie.Vehicle.Command.Page.sections(), Aerie.Vehicle.Firmware.Page.sections())
    Aerie.Vehicle.Command.Page.renew(File.read!(@page), sections)
  end

  @impl Mix.Task
  def run(_args) do
    File.write!(@page, page())
    Mix.shell().info("wrote #{Path.relative_to_cwd(@page)}")
  end
end
