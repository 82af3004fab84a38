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

  # The two clocks can't be read at once: between them a busy machine may stop this process for as long as it likes.
  @at_once_us 100
  @tries 20

  @doc "The offset as of now, by the closest of some readings."
  @spec offset() :: offset()
  def offset, do: offset(@tries, nil)

  defp offset(0, {_apart, offset}), do: offset

  defp offset(tries, best) do
    before = System.monotonic_time(:microsecond)
    unix = System.os_time(:microsecond)
    apart = System.monotonic_time(:microsecond) - before
    best = min(best || {apart, unix - before}, {apart, unix - before})
    if apart <= @at_once_us, do: unix - before, else: offset(tries - 1, best)
  end

  @doc "By how much the clock was set between two looks at it (microseconds, forward is positive); 0 when it was not."
  @spec step(offset(), offset()) :: integer()
  def step(before, now) when is_integer(before) and is_integer(now) do
    if abs(now - before) >= @least_us, do: now - before, else: 0
  end
end
