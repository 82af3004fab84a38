defmodule MavRouter.Link.Server.Restarts do
  @moduledoc """
  How long the process of a link waits before it connects when it was restarted often lately: a link that keeps crashing
  is back within a second, but does not keep a processor busy.

  A value: the times (monotonic ms) of the last restarts, kept in the link's snapshot.
  """

  alias Aerie.Base.Timing.Backoff

  @window_ms 5_000
  @free 3
  @min_ms 25
  @max_ms 500
  @kept 20

  @type t :: [integer]

  @doc "Notes a start at `now`. `former` is what the former process left, nil for the first start."
  @spec add(t | nil, now :: integer) :: t
  def add(nil, _now), do: []
  def add(former, now), do: [now | former |> Enum.filter(&(now - &1 < @window_ms)) |> Enum.take(@kept - 1)]

  @doc "How long to wait before connecting, in ms: nothing for the first #{@free} restarts within #{div(@window_ms, 1000)} s."
  @spec wait(t) :: non_neg_integer
  def wait(restarts), do: Backoff.wait(max(length(restarts) - @free, 0), @min_ms, @max_ms, 1.0)
end
