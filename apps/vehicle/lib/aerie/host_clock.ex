defmodule Aerie.HostClock do
  @moduledoc """
  Notices that the machine's clock was set: by NTP, by hand, by a GPS that a companion computer without a battery-backed
  clock waits for.

  Times of arrival are unix time, because they are compared with those of other machines. How long ago something was is
  not for the unix time to tell: after a clock was set back an hour, everything would be new for an hour. So whoever keeps
  such times also keeps the `offset/0` between the two clocks and, when it jumps, moves what it keeps by `step/2`.
  """

  # More than a clock that is being slowed down or sped up moves between two looks, less than anybody calls a set clock.
  @least_us 500_000

  @typedoc "Unix time less monotonic time, in microseconds."
  @type offset :: integer()

  @doc "The offset as of now."
  @spec offset() :: offset()
  def offset, do: System.os_time(:microsecond) - System.monotonic_time(:microsecond)

  @doc "By how much the clock was set between two looks at it (microseconds, forward is positive); 0 when it was not."
  @spec step(offset(), offset()) :: integer()
  def step(before, now) when is_integer(before) and is_integer(now) do
    if abs(now - before) >= @least_us, do: now - before, else: 0
  end
end
