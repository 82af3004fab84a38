defmodule Aerie.Base.Timing.HostClock do
  @moduledoc """
  Notices when the machine's clock is set: by NTP, by hand, or by the GPS that a companion computer without a battery-backed clock
  waits for.

  Times of arrival are unix times, because they are compared with those of other machines. But unix time cannot tell how long ago
  something was: after a clock is set back an hour, everything would be new for an hour. So a module that keeps such times also keeps
  the `offset/0` between the two clocks, and moves its times by `step/2` when the offset jumps.
  """

  # More than a clock that is being slewed moves between two looks, less than a clock that is set.
  @least_us 500_000

  @typedoc "Unix time less monotonic time, in microseconds."
  @type offset :: integer()

  # The two clocks cannot be read at once: a busy machine may stop this process in between.
  @at_once_us 100
  @tries 20

  @doc "The present offset, by the closest of several readings."
  @spec offset() :: offset()
  def offset, do: offset(@tries, nil)

  defp offset(0, {_apart, offset}), do: offset

  defp offset(tries, best) do
    # Erlang's own: each vehicle asks with each of its frames.
    before = :erlang.monotonic_time(:microsecond)
    unix = :os.system_time(:microsecond)
    gap = :erlang.monotonic_time(:microsecond) - before

    if gap <= @at_once_us,
      do: unix - before,
      else: offset(tries - 1, min(best || {gap, unix - before}, {gap, unix - before}))
  end

  @doc "By how much the clock was set between two looks at it (microseconds, forward is positive); 0 when it was not."
  @spec step(offset(), offset()) :: integer()
  def step(before, now) when is_integer(before) and is_integer(now) do
    if abs(now - before) >= @least_us, do: now - before, else: 0
  end
end
