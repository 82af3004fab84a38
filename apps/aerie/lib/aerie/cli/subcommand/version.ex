defmodule Aerie.CLI.Subcommand.Version do
  @moduledoc "`aerie version`."
  @behaviour Aerie.CLI.Subcommand

  @impl Aerie.CLI.Subcommand
  def run(_request) do
    _ = Application.load(:aerie)
    {0, "aerie #{Application.spec(:aerie, :vsn)} (Elixir #{System.version()}, OTP #{System.otp_release()})\n"}
  end
end
