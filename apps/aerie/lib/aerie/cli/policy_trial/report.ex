defmodule Aerie.CLI.PolicyTrial.Report do
  @moduledoc "What `aerie policy try` prints (pure): decisions as rows or as JSON, and the summary."

  alias Aerie.Base.Json
  alias Aerie.CLI.Output.Columns

  # Set-points, sticks and items of a mission come in rows of the same decision.
  @run_us 5_000_000
  @max_rows 500

  defstruct rows: %{}, open: %{}, more: 0, commands: 0, rules: %{}, lacking: 0

  @type t :: %__MODULE__{
          rows: %{non_neg_integer() => map()},
          open: map(),
          more: non_neg_integer(),
          commands: non_neg_integer(),
          rules: %{atom() => pos_integer()},
          lacking: non_neg_integer()
        }

  @heading ~w(TIME WHO ROLE VEHICLE COMMAND MESSAGE N DECISION RULE REASON)

  @doc "Takes a decision in."
  @spec add(t(), Aerie.Fleet.Replay.PolicyTrial.decision()) :: t()
  def add(report, decision) do
    report = report |> count(decision) |> lacking(decision)
    key = {decision.who, decision.vehicle, decision.command, decision.name, rule(decision)}

    case report.open do
      %{^key => {n, at}} when decision.at - at < @run_us ->
        %{
          report
          | rows: Map.update!(report.rows, n, &%{&1 | n: &1.n + 1}),
            open: Map.put(report.open, key, {n, decision.at})
        }

      _new when map_size(report.rows) < @max_rows ->
        n = map_size(report.rows)

        %{
          report
          | rows: Map.put(report.rows, n, Map.put(decision, :n, 1)),
            open: Map.put(report.open, key, {n, decision.at})
        }

      _full ->
        %{report | more: report.more + 1}
    end
  end

  defp count(report, decision) do
    rules =
      case rule(decision) do
        nil -> report.rules
        rule -> Map.update(report.rules, rule, 1, &(&1 + 1))
      end

    %{report | commands: report.commands + 1, rules: rules}
  end

  defp lacking(report, %{lacking: []}), do: report
  defp lacking(report, _decision), do: %{report | lacking: report.lacking + 1}

  defp rule(%{decision: :allow}), do: nil
  defp rule(%{decision: {:deny, rule, _reason}}), do: rule

  @doc "The numbers of two reports together, without rows."
  @spec sum(t(), t()) :: t()
  def sum(one, other) do
    %__MODULE__{
      commands: one.commands + other.commands,
      lacking: one.lacking + other.lacking,
      rules: Map.merge(one.rules, other.rules, fn _rule, a, b -> a + b end)
    }
  end

  @doc "How many would be refused."
  @spec refused(t()) :: number()
  def refused(report), do: report.rules |> Map.values() |> Enum.sum()

  @doc "The table of a recording."
  @spec table(t()) :: iodata()
  def table(%{rows: rows}) when rows == %{}, do: "no commands\n"

  def table(report) do
    rows = for {_n, row} <- Enum.sort(report.rows), do: row(row)

    [
      Columns.render(@heading, rows),
      if(report.more > 0, do: "and #{report.more} more; --json prints all\n", else: [])
    ]
  end

  defp row(row) do
    {decision, rule, reason} = words(row)
    n = if row.n > 1, do: row.n
    [Json.time(row.at), row.who, row.role, row.vehicle, row.command, row.name, n, decision, rule, reason]
  end

  defp words(%{decision: :allow}), do: {"allow", nil, nil}
  defp words(%{decision: {:deny, rule, reason}, lacking: []}), do: {"deny", rule, reason}

  defp words(%{decision: {:deny, rule, reason}, lacking: lacking}),
    do: {"deny", rule, "#{reason} [not recorded before: #{Enum.map_join(lacking, ", ", &name/1)}]"}

  defp name(:in_air), do: "whether it is in the air"
  defp name(:armed), do: "whether it is armed"
  defp name(field), do: Atom.to_string(field)

  @doc "A decision as a line of JSON."
  @spec json(String.t(), Aerie.Fleet.Replay.PolicyTrial.decision()) :: iodata()
  def json(recording, decision) do
    {word, rule, reason} = words(%{decision | lacking: []})

    line(%{
      type: "decision",
      recording: recording,
      time: Json.time(decision.at),
      who: decision.who,
      role: decision.role,
      via: decision.via,
      vehicle: decision.vehicle,
      message: decision.name,
      command: decision.command,
      decision: word,
      rule: rule,
      reason: reason,
      not_recorded: decision.lacking
    })
  end

  @doc "The last line of JSON."
  @spec json_summary(
          t(),
          recordings :: non_neg_integer(),
          %{atom() => pos_integer()},
          remarks :: [String.t()]
        ) :: iodata()
  def json_summary(report, recordings, skipped, remarks) do
    line(%{
      type: "summary",
      recordings: recordings,
      commands: report.commands,
      refused: refused(report),
      by_rule: report.rules,
      not_recorded: report.lacking,
      not_judged: skipped,
      remarks: remarks
    })
  end

  defp line(map), do: [map |> Json.plain() |> JSON.encode!(), ?\n]

  @doc "The summary for people."
  @spec summary(t(), recordings :: non_neg_integer(), %{atom() => pos_integer()}) :: iodata()
  def summary(report, recordings, skipped) do
    [
      "#{report.commands} commands in #{recordings} recordings: #{refused(report)} would be refused",
      rules(report.rules),
      "\n",
      if(report.lacking > 0,
        do: "#{report.lacking} of these refusals lack something that the recording had not told by then\n",
        else: []
      ),
      for({reason, n} <- Enum.sort(skipped), do: "not judged: #{n} #{skipped(reason)}\n")
    ]
  end

  defp rules(rules) when rules == %{}, do: ""

  defp rules(rules),
    do: [" (", rules |> Enum.sort() |> Enum.map_join(", ", fn {rule, n} -> "#{rule} #{n}" end), ")"]

  defp skipped(:unheard), do: "to vehicles that the recording had not heard by then"
  defp skipped(:vehicle), do: "from one vehicle to another, which router.between_vehicles decides"
  defp skipped(:unknown), do: "messages that no table knows; policy.unknown decides"
  defp skipped(:unreadable), do: "messages that cannot be decoded"
  defp skipped(:never), do: "messages that nobody may send to a vehicle"
  defp skipped(:copy), do: "copies of frames that were judged"
  defp skipped(:in_ledger), do: "frames of the gateway, for which the ledger's commands stand"
  defp skipped(:malformed), do: "commands of the ledger that this version cannot read"
end
