defmodule Aerie.CLI.Help.About do
  @moduledoc "`aerie version`, `aerie man` and `aerie completion`: what the program says about itself."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Help.{Completion, Man}

  @impl Aerie.CLI.Subcommand
  def run(%{name: "version"}),
    do: {0, "aerie #{version()} (Elixir #{System.version()}, OTP #{System.otp_release()})\n"}

  def run(%{name: "man", rows: rows}), do: {0, Man.page(rows, to_string(version()))}
  def run(%{name: "completion", rows: rows}), do: {0, Completion.bash(rows)}

  defp version do
    _ = Application.load(:aerie)
    Application.spec(:aerie, :vsn)
  end
end
