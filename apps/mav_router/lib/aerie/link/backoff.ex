defmodule Aerie.Link.Backoff do
  @moduledoc """
  How long to wait before the next try to connect: at once after the first fault, then twice as long each time, with
  jitter, never more than 30 s. A value, without a clock or a random source of its own.

  | try after the fault | wait in ms |
  |---|---|
  | 1 | 0 |
  | 2 | 250 to 500 |
  | 3 | 500 to 1,000 |
  | … | … |
  | 8 and later | 15,000 to 30,000 |

  Jitter keeps ten links that lost the same radio from calling it in step.
  """

  defstruct attempt: 0, min: 250, max: 30_000

  @typedoc "`attempt`: tries made since the last `reset/1`; `min`, `max`: ms"
  @type t :: %__MODULE__{attempt: non_neg_integer, min: pos_integer, max: pos_integer}

  @doc "A fresh one; `min` and `max` bound every wait but the first, in ms."
  @spec new(min :: pos_integer, max :: pos_integer) :: t
  def new(min \\ 250, max \\ 30_000) when min > 0 and max >= min, do: %__MODULE__{min: min, max: max}

  @doc "The next wait in ms. `random` is from 0.0 to 1.0 and picks within the jitter."
  @spec next(t, random :: float) :: {non_neg_integer, t}
  def next(%__MODULE__{attempt: 0} = backoff, _random), do: {0, %{backoff | attempt: 1}}

  def next(%__MODULE__{attempt: attempt} = backoff, random) do
    # 2^20 times any sensible minimum is beyond any sensible maximum.
    top = min(backoff.max, backoff.min * Integer.pow(2, min(attempt, 20)))
    low = max(backoff.min, div(top, 2))
    {low + round((max(top, low) - low) * random), %{backoff | attempt: attempt + 1}}
  end

  @doc "After a connection that brought something and was short: the next try comes after the shortest wait but none."
  @spec soon(t) :: t
  def soon(%__MODULE__{} = backoff), do: %{backoff | attempt: min(backoff.attempt, 1)}

  @doc "After a connection that proved good: the next fault is tried again at once."
  @spec reset(t) :: t
  def reset(%__MODULE__{} = backoff), do: %{backoff | attempt: 0}
end
