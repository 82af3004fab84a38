defmodule Aerie.Incident.Timeline do
  @moduledoc "Events, commands and notes of the audit log in one order, for the page's marks and table. Pure."

  alias Aerie.Incident.{Commands, Span}
  alias Aerie.Vehicle.Event

  # An event of a replay and the gateway's own of the same moment.
  @same_us 2_000_000
  @max_rows 2_000

  @typedoc "`n`: number of the row; `kind` chooses the colour of its mark; `what` and the others are texts."
  @type row :: %{
          n: pos_integer(),
          at: integer(),
          kind: :event | :alarm | :command | :refused | :note,
          what: String.t(),
          who: String.t(),
          decision: String.t(),
          result: String.t()
        }

  @doc "Rows in order, and how many there are beyond #{@max_rows}: plain events are left out first."
  @spec rows([Event.t()], [Event.t()], [map()], [Aerie.Incident.Records.entry()], Span.t()) ::
          {[row()], more :: non_neg_integer()}
  def rows(replayed, live, commands, audit, span) do
    events = replayed ++ Enum.reject(live, &told?(&1, replayed))

    rows =
      Enum.map(events, &event/1) ++
        Enum.map(commands, &command/1) ++ for(record <- audit, row = note(record), do: row)

    {shown, more} =
      rows
      |> Enum.filter(&Span.within?(span, &1.at))
      |> Enum.sort_by(&{&1.kind == :event, &1.at})
      |> Enum.split(@max_rows)

    shown = Enum.sort_by(shown, &{&1.at, &1.kind, &1.what})
    {shown |> Enum.with_index(1) |> Enum.map(fn {row, n} -> Map.put(row, :n, n) end), length(more)}
  end

  defp told?(event, replayed),
    do: Enum.any?(replayed, &(&1.type == event.type and abs(&1.time - event.time) < @same_us))

  defp event(%Event{} = event) do
    severity = with(%{severity: severity} <- Event.Types.get(event.type), do: severity)
    kind = if is_integer(severity) and severity <= 4, do: :alarm, else: :event
    row(event.time, kind, told(event), "", "", "")
  end

  defp told(%{type: "statustext", data: %{"text" => text} = data}),
    do: words(["statustext", data["severity_name"], part(data)]) <> ": " <> value(text)

  defp told(event), do: "#{event.type} #{values(Map.delete(event.data, "position"))}"

  defp part(data), do: if(data["component"], do: "component #{data["component"]}")

  defp command(command) do
    kind = if command["decision"] == "deny", do: :refused, else: :command

    who = [
      command["source"],
      command["role"] && "(#{command["role"]})",
      command["via"] && "via #{command["via"]}"
    ]

    decision = [command["decision"], command["rule"] && "rule #{command["rule"]}", command["reason"]]

    result = [
      command["result"],
      if(command["result_reason"] != command["reason"], do: command["result_reason"])
    ]

    what = "#{command["type"]} #{values(command["params"] || %{})}"
    row(Commands.at(command), kind, what, words(who), words(decision), words(result))
  end

  # Decisions and results are the commands' rows.
  defp note(%{fields: %{"type" => type}}) when type in ["decision", "result"], do: nil

  defp note(%{at: at, fields: fields}) do
    values = Map.drop(fields, ~w(n at prev hash type source via reason))

    row(
      at,
      :note,
      "#{fields["type"]} #{values(values)}",
      words([fields["source"]]),
      "",
      words([fields["reason"]])
    )
  end

  defp row(at, kind, what, who, decision, result),
    do: %{at: at, kind: kind, what: String.trim(what), who: who, decision: decision, result: result}

  defp words(list), do: list |> Enum.reject(&(&1 in [nil, ""])) |> Enum.map_join(" ", &value/1)

  defp values(map) when is_map(map) do
    for({key, value} <- Enum.sort(map), not is_nil(value), do: "#{key}=#{value(value)}") |> Enum.join(" ")
  end

  defp values(other), do: value(other)

  defp value(text) when is_binary(text), do: text
  defp value(number) when is_float(number), do: :erlang.float_to_binary(number, [:compact, decimals: 7])
  defp value(other), do: other |> Aerie.Base.Json.plain() |> JSON.encode!()
end
