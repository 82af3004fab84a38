defmodule Aerie.CLI.CheckAudit do
  @moduledoc "`bin/run --check-audit DIR`: checks that an audit log is complete and unchanged (`Aerie.Control.Policy.Audit.Verify`)."

  alias Aerie.Control.Policy.Audit.Verify

  @doc "`{:finish, text}` for a log that is intact, `{:denied, text}` with its problems, `{:fail, text}` if it cannot be read."
  @spec run(Path.t(), folder :: String.t()) :: {:finish | :denied | :fail, String.t()}
  def run(dir, folder) do
    case dir |> Path.expand(folder) |> Verify.folder() do
      {:ok, %{problems: []} = report} -> {:finish, text(report, "intact")}
      {:ok, report} -> {:denied, text(report, "NOT intact")}
      {:error, reason} -> {:fail, "error: #{reason}\n"}
    end
  end

  defp text(report, word) do
    lines = [
      "#{word}: #{report.records} records, #{report.first || 0} to #{report.last}, hash #{report.hash}"
    ]

    Enum.map_join(lines ++ report.problems ++ Enum.map(report.notes, &"note: #{&1}"), &(&1 <> "\n"))
  end
end
