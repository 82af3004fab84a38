defmodule Aerie.Fleet.Replay.Clock do
  @moduledoc """
  The time of a replay: that of the recording's frames, and the ticks that a live gateway would have had between them. A pure
  value.

  A tick is due every 100 ms, as in `Aerie.Vehicle.Session`. During a silence ticks are rarer: after ten seconds one a second,
  and after ten minutes, when nothing waits any more, none until the next frame. So a gap of a month costs seven hundred
  ticks.

  A frame that is more than two seconds older than the one before means that a clock was set back or that another recording
  begins: time starts again with that frame. So it does when a recorder without a clock, whose time began in 1970, gets one.
  """

  @tick_us 100_000
  @slow_us 1_000_000
  @patience_us 10_000_000
  @silence_us 600_000_000
  @back_us 2_000_000
  @year_2000 946_684_800_000_000
  @day_us 86_400_000_000

  defstruct [:now, :next, passed: 0]

  @typedoc """
  - `now`: the newest time of a frame; `next`: the tick after it (unix microseconds), nil before the first frame
  - `passed`: how long the recording is (microseconds), without what lies between its parts
  """
  @type t :: %__MODULE__{now: integer | nil, next: integer | nil, passed: non_neg_integer}

  @doc "A clock that has seen no frame."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc """
  A frame came `at`: the ticks before it, oldest first, or `:restarted` if time starts again. A frame that is only a little older
  than the one before gives no ticks.
  """
  @spec advance(t, integer) :: {[integer] | :restarted, t}
  def advance(%__MODULE__{now: nil} = clock, at), do: {[], begin(clock, at)}
  def advance(%__MODULE__{now: now} = clock, at) when at < now - @back_us, do: {:restarted, begin(clock, at)}

  def advance(%__MODULE__{now: now} = clock, at) when now < @year_2000 and at - now > @day_us,
    do: {:restarted, begin(clock, at)}

  def advance(%__MODULE__{next: next} = clock, at) when at < next,
    do: {[], pass(clock, max(clock.now, at))}

  def advance(%__MODULE__{now: now, next: next} = clock, at) do
    {ticks, next} = ticks(next, at, now, [])
    {Enum.reverse(ticks), %{pass(clock, at) | next: next}}
  end

  defp begin(clock, at), do: %{clock | now: at, next: at + @tick_us}

  defp pass(%{now: now} = clock, at) when at - now > @day_us, do: %{clock | now: at}
  defp pass(%{now: now} = clock, at), do: %{clock | now: at, passed: clock.passed + at - now}

  defp ticks(next, at, _heard, ticks) when next > at, do: {ticks, next}

  defp ticks(next, at, heard, ticks) when next - heard <= @patience_us,
    do: ticks(next + @tick_us, at, heard, [next | ticks])

  defp ticks(next, at, heard, ticks) when next - heard <= @silence_us,
    do: ticks(next + @slow_us, at, heard, [next | ticks])

  defp ticks(_next, at, _heard, ticks), do: {ticks, at + @tick_us}
end
