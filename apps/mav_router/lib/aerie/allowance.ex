defmodule Aerie.Allowance do
  @moduledoc """
  So many at once, and then one in so long: what bounds the rate of something that costs more than a frame. A token bucket
  as one integer, the time at which it will be full again.
  """

  @typedoc "In the unit of the clock that it is asked with; nil: full."
  @type t :: integer | nil

  @doc """
  Takes one at `now`, of `burst` that are there when nothing was taken for long; one is added every `interval`. `keep` are
  left for others that ask for the same.
  """
  @spec take(t, now :: integer, interval :: pos_integer, burst :: pos_integer, keep :: non_neg_integer) ::
          {:ok, t} | :none
  def take(full, now, interval, burst, keep \\ 0) do
    next = max(full || now, now) + interval
    if next - now <= (burst - keep) * interval, do: {:ok, next}, else: :none
  end
end
