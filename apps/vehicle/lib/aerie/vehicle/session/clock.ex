defmodule Aerie.Vehicle.Session.Clock do
  @moduledoc """
  The time of one vehicle between its frames: that of the last frame plus what has passed since by the monotonic clock,
  at the link's speed. A pure value; all times are in microseconds, and a `moment` is one of the monotonic clock.

  It also knows when time begins again, because the next frames' time is not comparable with that of the last ones: when
  a recording begins again, and perhaps with the first frames after a restart. A live frame that is late by seconds, as
  after a pause of the whole machine, is only late.
  """

  # A larger difference between a frame's time and the expected one means that a clock was set.
  @clock_set_us 3_000_000
  # Two links may deliver a little out of order.
  @back_us 2_000_000
  # No flight has such a silence.
  @day_us 86_400_000_000

  @enforce_keys [:at, :moment, :speed]
  defstruct [:at, :moment, :speed, :by]

  @typedoc """
  - `at`, `moment`: the time of the last frame, and when it was handled
  - `speed`: how much faster than ours its time passes
  - `by`: whose time its frames have; nil for what an earlier process heard
  """
  @type t :: %__MODULE__{
          at: integer(),
          moment: integer(),
          speed: number(),
          by: :host | :recording | nil
        }
  @type speed :: :live | number()

  @doc "That of what an earlier process heard last."
  @spec new(at :: integer(), moment :: integer(), number()) :: t()
  def new(at, moment, speed), do: %__MODULE__{at: at, moment: moment, speed: speed}

  @doc "A frame that came `at` was handled."
  @spec frame(at :: integer(), moment :: integer(), speed()) :: t()
  def frame(at, moment, :live), do: %__MODULE__{at: at, moment: moment, speed: 1.0, by: :host}
  def frame(at, moment, speed), do: %__MODULE__{at: at, moment: moment, speed: speed, by: :recording}

  @doc "The time at a moment; nil before anything was heard. What waited behind a frame is not older than the frame."
  @spec expected(t() | nil, moment :: integer()) :: integer() | nil
  def expected(nil, _moment), do: nil

  def expected(%{at: at} = clock, moment) when is_integer(at),
    do: at + round(max(moment - clock.moment, 0) * clock.speed)

  @doc """
  Whether time begins again with a frame that came `at`. `now` is the newest time that is known, `host` the machine's
  clock less the monotonic one (`Aerie.Base.Timing.HostClock`).
  """
  @spec restarted?(
          t() | nil,
          speed(),
          now :: integer() | nil,
          at :: integer(),
          moment :: integer(),
          host :: integer()
        ) ::
          boolean()
  def restarted?(_clock, _speed, nil, _at, _moment, _host), do: false

  # Times that the machine's clock has not reached were stamped before it was set back. A frame that is late by seconds
  # waited for a busy link, or the machine stood still: what was waited for meanwhile is waited for still.
  def restarted?(%{by: :host}, :live, now, at, moment, host), do: max(now, at) > moment + host + @clock_set_us

  # The first frames since the process was started, or since those of a recording.
  def restarted?(clock, :live, _now, at, moment, _host) do
    expected = expected(clock, moment)
    expected != nil and abs(at - expected) > @clock_set_us
  end

  # Another recording, the same once more, or one whose clock was set.
  def restarted?(_clock, _recording, now, at, _moment, _host), do: at < now - @back_us or at > now + @day_us
end
