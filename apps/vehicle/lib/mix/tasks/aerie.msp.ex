defmodule Mix.Tasks.Aerie.Msp do
  @shortdoc "Renews the table of docs/msp.md"
  @moduledoc """
  Renews the table of `docs/msp.md` from the tables of messages and parameters (`MavCodec.Msp.Messages`, `MavCodec.Msp.Params`).

      mix aerie.msp
  """
  use Mix.Task

  alias Aerie.Vehicle.Command.Page

  @page Path.expand("../../../../../docs/msp.md", __DIR__)

  @doc "The page as it is to be."
  @spec page() :: String.t()
  def page, do: Page.renew(File.read!(@page), Aerie.Vehicle.Firmware.Msp.Page.sections())

  @impl Mix.Task
  def run(_args) do
    File.write!(@page, page())
    Mix.shell().info("wrote #{Path.relative_to_cwd(@page)}")
  end
end
