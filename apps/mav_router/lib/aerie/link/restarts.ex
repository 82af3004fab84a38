defmodule Aerie.Link.Restarts do
  @moduledoc """
  A link whose process keeps crashing is started again each time, at once at first, then a little later: never so late
  that it is not back within a second, never so often that it keeps a processor busy.

  A value: the times (monotonic ms) of the last restarts, kept in the link's snapshot.
  """

  @window_ms 5_000
  @free 3
  @step_ms 50
  @most_ms 500
  @kept 20

  @type t :: [integer]

  @doc "Notes a start; `former` is what the former process left, nil for the first start."
  @spec add(t | nil, integer) :: t
  def add(nil, _now), do: []
  def add(former, now), do: [now | former |> Enum.filter(&(now - &1 < @window_ms)) |> Enum.take(@kept - 1)]

  @doc "How long the newest restart waits before it connects, in ms."
  @spec wait(t) :: non_neg_integer
  def wait(restarts), do: (max(length(restarts) - @free, 0) * @step_ms) |> min(@most_ms)
end
