defmodule Aerie.Console.Pages.Recordings.TimeLine do
  @moduledoc "The events of a recording on a time line, as `Aerie.Fleet.Replay` finds them."

  alias Aerie.Fleet.Replay
  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Vehicle.Events.Timeline

  @max_events 500
  # Ten megabytes of a file take about a second and a few megabytes of memory.
  @max_bytes 128 * 1024 * 1024

  @typedoc "`x`: 0 to 1000 over the recording; `at`: seconds since its beginning, as text; `more`: events beyond the first #{@max_events}."
  @type t :: %{
          from: String.t(),
          seconds: number(),
          frames: non_neg_integer(),
          vehicles: [String.t()],
          damaged: non_neg_integer(),
          events: [map()],
          more: non_neg_integer()
        }

  @doc "The time line of a file of this size."
  @spec read(Path.t(), non_neg_integer()) :: {:ok, t()} | {:error, String.t()}
  def read(_path, bytes) when bytes > @max_bytes,
    do: {:error, "it is too large for this page: use aerie replay FILE"}

  def read(path, _bytes) do
    with {:ok, %{events: events, summary: summary}} <- Replay.run(path), do: {:ok, of(events, summary)}
  end

  defp of(events, %{from: from, to: to} = summary) do
    length_us = max(to - from, 1)
    shown = events |> Enum.take(@max_events) |> Enum.with_index()

    %{
      from: Clock.full(from),
      seconds: Float.round(summary.duration_us / 1_000_000, 1),
      frames: summary.frames,
      vehicles: summary.vehicles,
      damaged: summary.damaged_parts,
      events: for({event, n} <- shown, do: row(event, n, from, length_us)),
      more: max(length(events) - @max_events, 0)
    }
  end

  defp row(event, n, from, length_us) do
    since = max(event.time - from, 0)
    line = Timeline.line(event)

    %{
      n: n,
      type: event.type,
      vehicle: event.vehicle,
      at: :erlang.float_to_binary(since / 1_000_000, decimals: 1),
      x: "#{min(round(since * 1000 / length_us), 1000)}",
      tone: line.tone,
      text: line.text
    }
  end
end
