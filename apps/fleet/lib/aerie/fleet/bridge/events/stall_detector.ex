defmodule Aerie.Fleet.Bridge.Events.StallDetector do
  @moduledoc """
  Detects that events wait and the stream confirms none. Pure; times in milliseconds.

  It is a problem if events have waited for ten seconds without any confirmation, whatever the state of the connection. The
  problem is over after five good seconds, so that a server that takes one event in ten seconds does not look healthy every
  ten seconds.
  """

  @after_ms 10_000
  @calm_ms 5_000

  defstruct since: nil, calm_since: nil, problem?: false

  @typedoc "`since`: when the last event was confirmed, or when they began to wait; nil while none waits."
  @type t :: %__MODULE__{since: integer() | nil, calm_since: integer() | nil, problem?: boolean()}

  @doc "No event waits."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "An event was confirmed."
  @spec confirmed(t(), integer()) :: t()
  def confirmed(stall, now), do: %{stall | since: now}

  @doc "Checks, from time to time; `waiting?` says whether events wait now."
  @spec check(t(), integer(), boolean()) :: t()
  def check(stall, now, waiting?) do
    since = if waiting?, do: stall.since || now
    evaluate(%{stall | since: since}, now, since != nil and now - since >= @after_ms)
  end

  defp evaluate(stall, _now, true), do: %{stall | problem?: true, calm_since: nil}
  defp evaluate(%{problem?: false} = stall, _now, false), do: stall
  defp evaluate(%{calm_since: nil} = stall, now, false), do: %{stall | calm_since: now}
  defp evaluate(stall, now, false) when now - stall.calm_since < @calm_ms, do: stall
  defp evaluate(stall, _now, false), do: %{stall | problem?: false, calm_since: nil}

  @doc "How long events have waited without any confirmation."
  @spec ms(t(), integer()) :: non_neg_integer()
  def ms(%{since: nil}, _now), do: 0
  def ms(%{since: since}, now) when is_integer(since) and is_integer(now), do: max(now - since, 0)
end
