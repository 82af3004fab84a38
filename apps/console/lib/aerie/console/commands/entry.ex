defmodule Aerie.Console.Commands.Entry do
  @moduledoc "The state of a command in words, with a tone and an icon, so that states differ by more than colour. Pure."

  alias Aerie.Vehicle.Command
  alias Aerie.Control.Commands
  alias Aerie.Console.Commands.{Catalog, Outcome, Wording}

  @typedoc """
    * `:state` - `:pending` (no answer yet), `:progress`, or a result's status
    * `:tone` - `:busy`, `:going`, `:good`, `:plain`, `:bad`, `:unsure`
    * `:going` - whether the vehicle is still carrying it out (`Aerie.Console.Commands.Outcome`)
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
          going: boolean(),
          state: :pending | :progress | atom(),
          tone: :busy | :going | :good | :plain | :bad | :unsure,
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

  @doc "How to show a command. `course`: how far the vehicle is with what it completed by beginning it, nil where that is not known."
  @spec of(Commands.entry(), Outcome.t() | nil) :: t()
  def of(entry, course \\ nil) do
    {state, tone, label, text, share} = entry |> state() |> with_course(course)

    %{
      id: entry.id,
      name: entry.type,
      title: Catalog.title(entry.type),
      params: Wording.params(entry.type, entry.params),
      source: entry.source,
      via: entry.via,
      at: entry.at,
      done_at: (course && course.at) || entry.done_at,
      going: course != nil and course.stage == :going,
      state: state,
      tone: tone,
      label: label,
      text: text,
      share: share,
      cancel: entry.result == nil and cancel?(Command.type(entry.type))
    }
  end

  @courses %{going: :going, there: :good, ended: :plain}

  defp with_course({:completed, _tone, _label, text, share}, %{stage: stage} = course),
    do: {:completed, @courses[stage], course.label, course.text || text, share}

  defp with_course(state, _none), do: state

  defp state(%{result: nil, progress: nil}), do: {:pending, :busy, "Pending", nil, nil}

  defp state(%{result: nil, progress: progress}) do
    share =
      with share when is_number(share) <- progress["progress"],
           do: share |> Kernel.*(100) |> round() |> max(0) |> min(100)

    {:progress, :busy, "Under way", progress["text"], share}
  end

  defp state(%{result: result}) do
    {tone, label} = result(result.status)
    {result.status, tone, label, reason(result) || meaning(result.status), nil}
  end

  defp reason(%{reason: reason}), do: reason && Command.on_pages(reason)

  @words Map.new(@results, fn {status, shown} -> {Atom.to_string(status), shown} end)

  @doc "A result's tone and word; by its name, that of an operation, which may also be a refusal of the shadow."
  @spec result(atom() | String.t()) :: {:good | :plain | :bad | :unsure, String.t()}
  def result(status) when is_atom(status), do: Map.fetch!(@results, status)
  def result(name), do: Map.get(@words, name, {:bad, "Failed"})

  @doc "The kind of badge for a tone."
  @spec badge(:busy | :going | :good | :plain | :bad | :unsure) :: String.t()
  def badge(tone) when tone in [:busy, :going], do: "info"
  def badge(:good), do: "ok"
  def badge(:plain), do: "plain"
  def badge(:bad), do: "bad"
  def badge(:unsure), do: "warn"

  # The meaning of an uncertain end is shown beside it.
  defp meaning(:accepted), do: "The vehicle accepted it. Its state does not show whether it acted."
  defp meaning(:timeout), do: "The vehicle may have done it."
  defp meaning(:unknown), do: "The vehicle may have done it."
  defp meaning(_status), do: nil

  # Transfers are in the list too, but not in the table of commands. All of them can be cancelled.
  defp cancel?(nil), do: true
  defp cancel?(type), do: type.cancel?

  @doc "Whether a command has no result yet."
  @spec under_way?(t()) :: boolean()
  def under_way?(life), do: life.state in [:pending, :progress]
end
