defmodule Aerie.Bridge.Backoff do
  @moduledoc "Pauses between attempts: the first retry at once, then doubling up to a limit, with jitter. Pure."

  @doc """
  Milliseconds before the next attempt after `failures` failures in a row (1 is the first): 0, then from `min` doubling
  to `max`, of which a random part between half and all is taken. `random` is between 0 and 1.
  """
  @spec delay(pos_integer(), pos_integer(), pos_integer(), float()) :: non_neg_integer()
  def delay(failures, min, max, random \\ :rand.uniform())
  def delay(1, _min, _max, _random), do: 0

  def delay(failures, min, max, random) do
    # The exponent is bounded: nothing is gained by a number of a thousand digits after a night without a network.
    full = min(max, min * Integer.pow(2, min(failures - 2, 24)))
    round(full * (0.5 + random / 2))
  end
end
