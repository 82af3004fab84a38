defmodule FleetWeb.Console.Commands.Life do
  @moduledoc "The state of a command in words, with a tone and an icon, so that states differ by more than colour. Pure."

  alias Aerie.Command.{Param, Result, Types}
  alias Aerie.Commands.Recent
  alias FleetWeb.Console.Commands.Catalog

  @typedoc """
    * `:state` - `:pending` (no answer yet), `:progress`, or a result's status
    * `:tone` - `:busy`, `:good`, `:plain`, `:bad`, `:unsure`
    * `:share` - 0..100, nil if the vehicle does not report it
    * `:cancel` - whether it can be cancelled
  """
  @type t :: %{
          id: String.t(),
          name: String.t(),
          title: String.t(),
          params: String.t(),
          source: String.t(),
          via: String.t(),
          at: integer(),
          done_at: integer() | nil,
          state: :pending | :progress | Result.status(),
          tone: :busy | :good | :plain | :bad | :unsure,
          label: String.t(),
          text: String.t() | nil,
          share: 0..100 | nil,
          cancel: boolean()
        }

  # A refusal by Aerie, one by the vehicle, and an unknown outcome call for different reactions.
  @results %{
    completed: {:good, "Done"},
    accepted: {:plain, "Accepted"},
    rejected: {:bad, "Refused"},
    denied: {:bad, "Not allowed"},
    failed: {:bad, "Failed"},
    cancelled: {:plain, "Cancelled"},
    timeout: {:unsure, "No answer"},
    unknown: {:unsure, "Unknown"},
    expired: {:bad, "Too late"}
  }

  @doc "How to show a command."
  @spec of(Recent.entry()) :: t()
  def of(entry) do
    {state, tone, label, text, share} = state(entry)

    %{
      id: entry.id,
      name: entry.type,
      title: Catalog.title(entry.type),
      params: params(entry.params),
      source: entry.source,
      via: entry.via,
      at: entry.at,
      done_at: entry.done_at,
      state: state,
      tone: tone,
      label: label,
      text: text,
      share: share,
      cancel: entry.result == nil and cancel?(Types.fetch(entry.type))
    }
  end

  defp state(%{result: nil, progress: nil}), do: {:pending, :busy, "Pending", nil, nil}

  defp state(%{result: nil, progress: progress}) do
    share =
      with share when is_number(share) <- progress["progress"],
           do: share |> Kernel.*(100) |> round() |> max(0) |> min(100)

    {:progress, :busy, "Under way", progress["text"], share}
  end

  defp state(%{result: result}) do
    {tone, label} = Map.fetch!(@results, result.status)
    {result.status, tone, label, result.reason || meaning(result.status), nil}
  end

  # The meaning of an uncertain end is shown beside it.
  defp meaning(:accepted), do: "the vehicle accepted it; nothing in its state shows more"
  defp meaning(:timeout), do: "the vehicle may have done it"
  defp meaning(:unknown), do: "the vehicle may have done it"
  defp meaning(_status), do: nil

  # Transfers are in the list too, but not in the table of commands. All of them can be cancelled.
  defp cancel?({:ok, type}), do: type.cancel?
  defp cancel?(:error), do: true

  @doc "Parameters in one line: `altitude 20, speed 5`."
  @spec params(map()) :: String.t()
  def params(params) do
    params
    |> Enum.sort()
    |> Enum.map_join(", ", fn {name, value} ->
      "#{String.replace(to_string(name), "_", " ")} #{value(value)}"
    end)
  end

  defp value(number) when is_float(number), do: number |> Float.round(7) |> Param.shown()
  defp value(list) when is_list(list), do: Enum.map_join(list, " ", &value/1)
  defp value(other) when is_binary(other) or is_atom(other) or is_integer(other), do: to_string(other)
  defp value(other), do: inspect(other, limit: 5, printable_limit: 60)

  @doc "Whether a command is under way."
  @spec under_way?(t()) :: boolean()
  def under_way?(life), do: life.tone == :busy
end
