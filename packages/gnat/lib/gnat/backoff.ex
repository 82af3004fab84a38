defmodule Gnat.Backoff do
  @moduledoc """
  The wait before the next try: none at first, then doubling from `min` to `max` milliseconds.

  Every wait but the first is spread over its upper half (50 to 100 %), so that clients do not
  reconnect to a restarted server all at once. The random number is an argument, so that tests can choose it.
  """

  @enforce_keys [:min, :max]
  defstruct [:min, :max, failures: 0]

  @type t :: %__MODULE__{min: pos_integer(), max: pos_integer(), failures: non_neg_integer()}

  @spec new(pos_integer(), pos_integer()) :: t()
  def new(min, max) when is_integer(min) and min > 0 and is_integer(max) and max >= min do
    %__MODULE__{min: min, max: max}
  end

  @doc "The wait before the next try, in ms, and the back-off for the one after it. `random` is in 0.0..1.0."
  @spec next(t(), random :: float()) :: {non_neg_integer(), t()}
  def next(%__MODULE__{failures: 0} = backoff, _random), do: {0, %{backoff | failures: 1}}

  def next(%__MODULE__{min: min, max: max, failures: failures} = backoff, random) do
    # 30 doublings cover any range of milliseconds; without a limit the number would grow for ever.
    ceiling = min(min * 2 ** min(failures - 1, 30), max)
    {round(ceiling / 2 + ceiling / 2 * random), %{backoff | failures: failures + 1}}
  end

  @doc "After a success: the next try has no wait again."
  @spec reset(t()) :: t()
  def reset(%__MODULE__{} = backoff), do: %{backoff | failures: 0}
end
