defmodule Aerie.CLI.Subcommand.Audit do
  @moduledoc "`aerie audit check`: whether an audit log is complete and unchanged."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Subcommand
  alias Aerie.Config
  alias Aerie.Control.Policy.Audit.Verify

  @impl Aerie.CLI.Subcommand
  def run(request) do
    with {:ok, folder} <- folder(request), {:ok, report} <- Verify.folder(folder) do
      if report.problems == [],
        do: {0, text(report, "intact")},
        else: {1, text(report, "NOT intact")}
    end
  end

  defp folder(%{arguments: %{"FOLDER" => given}, folder: folder}), do: {:ok, Path.expand(given, folder)}

  # The gateway's own folders are relative to where it runs.
  defp folder(request) do
    case Subcommand.Machine.Config.load(request) do
      {:ok, config} -> {:ok, Path.expand(config.policy.audit.dir)}
      {:error, errors} -> {:error, Config.format_errors(errors)}
    end
  end

  defp text(report, word) do
    counted =
      "#{word}: #{report.records} records, #{report.first || 0} to #{report.last}, hash #{report.hash}"

    Enum.map([counted | report.problems] ++ Enum.map(report.notes, &"note: #{&1}"), &[&1, ?\n])
  end
end
