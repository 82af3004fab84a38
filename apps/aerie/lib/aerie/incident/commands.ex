defmodule Aerie.Incident.Commands do
  @moduledoc """
  The commands of a vehicle: who asked for what, who decided how by which rule, when it was sent, how it ended. Joined from the audit log and
  the ledger by the command's id. What a client sent as MAVLink has no id, and is a row of its own. Pure.
  """

  alias Aerie.Base.Json
  alias Aerie.Incident.{Records, Span}

  @doc "Rows with text keys, those that came or ended within the span, in the order of their times."
  @spec join([Records.entry()], %{String.t() => map()}, String.t(), Span.t()) :: [%{String.t() => term()}]
  def join(audit, ledger, vehicle, span) do
    {with_id, without} =
      audit
      |> Enum.filter(&(&1.fields["vehicle"] == vehicle and &1.fields["type"] in ["decision", "result"]))
      |> Enum.split_with(&is_binary(&1.fields["id"]))

    by_id = Enum.group_by(with_id, & &1.fields["id"])
    ids = Enum.uniq(Map.keys(by_id) ++ Map.keys(ledger))

    rows =
      for(id <- ids, row = row(id, by_id[id] || [], ledger[id] || %{}), do: row) ++
        for(record <- without, do: record |> decision() |> Map.put("received_at", record.at))

    rows
    |> Enum.filter(&(&1["vehicle"] == vehicle and covered?(&1, span)))
    |> Enum.sort_by(&{at(&1), &1["id"] || "", &1["type"] || ""})
  end

  @doc "When a row's command came, as far as it is known (unix microseconds)."
  @spec at(%{String.t() => term()}) :: integer()
  def at(row), do: row["received_at"] || row["decided_at"] || row["done_at"] || 0

  @doc "A row with its times as text."
  @spec plain(%{String.t() => term()}) :: %{String.t() => term()}
  def plain(row) do
    Enum.reduce(~w(received_at decided_at sent_at done_at), row, fn key, row ->
      if is_integer(row[key]), do: Map.update!(row, key, &Json.time/1), else: row
    end)
  end

  defp covered?(row, span), do: Span.within?(span, at(row)) or Span.within?(span, row["done_at"])

  defp row(id, records, entry) do
    envelope = entry["envelope"] || %{}
    decided = Enum.find(records, &(&1.fields["type"] == "decision"))
    ended = Enum.find(records, &(&1.fields["type"] == "result"))

    %{"id" => id}
    |> put(Map.take(envelope, ~w(vehicle type params source issued_at deadline)))
    |> put(if(ended, do: result(ended), else: %{}))
    |> put(if(decided, do: decision(decided), else: %{}))
    |> put(Map.drop(entry, ["envelope"]))
  end

  # A later part never makes a value unknown.
  defp put(row, more), do: Map.merge(row, Map.reject(more, fn {_key, value} -> is_nil(value) end))

  defp decision(%{at: at, fields: fields}) do
    fields
    |> Map.take(~w(vehicle params source role via says decision rule reason result))
    |> Map.put("type", fields["command"])
    |> Map.put("decided_at", at)
  end

  defp result(%{at: at, fields: fields}) do
    %{
      "vehicle" => fields["vehicle"],
      "type" => fields["command"],
      "source" => fields["source"],
      "result" => fields["result"],
      "result_reason" => fields["reason"],
      "done_at" => at
    }
  end
end
