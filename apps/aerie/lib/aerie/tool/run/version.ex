defmodule Aerie.Tool.Run.Version do
  @moduledoc "`aerie version`."
  @behaviour Aerie.Tool.Subcommand

  @impl Aerie.Tool.Subcommand
  def run(_request) do
    _ = Application.load(:aerie)
    {0, "aerie #{Application.spec(:aerie, :vsn)} (Elixir #{System.version()}, OTP #{System.otp_release()})\n"}
  end
end
