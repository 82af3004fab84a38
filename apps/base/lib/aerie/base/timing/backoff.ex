defmodule Aerie.Base.Timing.Backoff do
  @moduledoc """
  How long to wait before the next attempt: none after the first failure, then twice as long each time, with jitter, up to
  a limit. A value without a clock. The random number can be passed, for tests.

  | attempt after the failure | wait in ms, with the defaults |
  |---|---|
  | 1 | 0 |
  | 2 | 250 to 500 |
  | 3 | 500 to 1,000 |
  | … | … |
  | 8 and later | 15,000 to 30,000 |

  Jitter keeps ten links that lost the same radio from calling it in step.
  """

  defstruct attempt: 0, min: 250, max: 30_000

  @typedoc "`attempt`: attempts made since the last `reset/1`; `min`, `max`: bounds of every wait but the first, in ms"
  @type t :: %__MODULE__{attempt: non_neg_integer, min: pos_integer, max: pos_integer}

  @doc "No failures yet; `min` and `max` bound every wait but the first, in ms."
  @spec new(min :: pos_integer, max :: pos_integer) :: t
  def new(min \\ 250, max \\ 30_000) when min > 0 and max >= min, do: %__MODULE__{min: min, max: max}

  @doc "The wait before the next attempt, in ms. `random`, from 0.0 to 1.0, picks within the jitter."
  @spec next(t, random :: float) :: {non_neg_integer, t}
  def next(%__MODULE__{attempt: attempt} = backoff, random \\ :rand.uniform()),
    do: {wait(attempt, backoff.min, backoff.max, random), %{backoff | attempt: attempt + 1}}

  @doc "The wait after so many attempts, in ms, for a caller that counts attempts itself."
  @spec wait(attempts :: non_neg_integer, pos_integer, pos_integer, random :: float) :: non_neg_integer
  def wait(attempts, min, max, random \\ :rand.uniform())
  def wait(0, _min, _max, _random), do: 0

  def wait(attempts, min, max, random) when is_integer(min) and is_integer(max) do
    # 2^20 times any sensible minimum is beyond any sensible maximum.
    longest = min(max, min * Integer.pow(2, min(attempts, 20)))
    shortest = max(min, div(longest, 2))
    shortest + round((longest - shortest) * random)
  end

  @doc "After a connection that was short but brought something: the next wait is the shortest one, but not none."
  @spec soon(t) :: t
  def soon(%__MODULE__{} = backoff), do: %{backoff | attempt: min(backoff.attempt, 1)}

  @doc "After success: the next failure is followed by an attempt at once."
  @spec reset(t) :: t
  def reset(%__MODULE__{} = backoff), do: %{backoff | attempt: 0}
end
