defmodule Aerie.Base.Timing.TokenBucket do
  @moduledoc """
  Limits the rate of something that costs more than a frame: a burst, and then one in an interval. A token bucket as one integer, the
  time at which it will be full again.
  """

  @typedoc "In the unit of the clock in use; nil: full."
  @type t :: integer | nil

  @doc """
  Takes a token at `now`, of `burst` that a full bucket has; one is added every `interval`. `keep` tokens are left for others.
  """
  @spec take(t, now :: integer, interval :: pos_integer, burst :: pos_integer, keep :: non_neg_integer) ::
          {:ok, t} | :none
  def take(full, now, interval, burst, keep \\ 0) do
    next = max(full || now, now) + interval
    if next - now <= (burst - keep) * interval, do: {:ok, next}, else: :none
  end
end
