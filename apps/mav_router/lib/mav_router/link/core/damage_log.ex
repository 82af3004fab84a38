defmodule MavRouter.Link.Core.DamageLog do
  @every_ms 10_000

  @moduledoc """
  When damaged frames are worth a line in the log: the first at once, then one line every #{div(@every_ms, 1000)} s with how many there were. A
  value.

  A few bytes between frames are not damage: every serial port that is opened in the middle of a frame has them.
  """

  alias MavRouter.Link.Core.Counters

  @names [:crc_errors, :incompatible, :resync_bytes]
  @noise_bytes 512

  @enforce_keys [:logged]
  defstruct [:logged, :at]

  @typedoc "`logged`: the counts of the last line; `at`: its time, monotonic ms"
  @type t :: %__MODULE__{logged: %{atom => non_neg_integer}, at: integer | nil}

  @doc "Nothing logged yet; counting begins with these counters."
  @spec new(Counters.t()) :: t
  def new(counters), do: %__MODULE__{logged: Map.take(counters, @names)}

  @doc "Checks the counters at `now` (monotonic ms): words for the log, or nil."
  @spec check(t, Counters.t(), integer) :: {String.t() | nil, t}
  def check(%__MODULE__{at: at} = damage, _counters, now) when at != nil and now - at < @every_ms,
    do: {nil, damage}

  def check(damage, counters, now) do
    new = Map.new(@names, &{&1, Map.fetch!(counters, &1) - damage.logged[&1]})

    if new.crc_errors + new.incompatible > 0 or new.resync_bytes >= @noise_bytes,
      do: {summary(new), %__MODULE__{logged: Map.take(counters, @names), at: now}},
      else: {nil, damage}
  end

  defp summary(new) do
    "received damaged data: #{new.crc_errors} frames with a wrong CRC, #{new.incompatible} with unknown flags, " <>
      "#{new.resync_bytes} bytes outside of frames (logged every #{div(@every_ms, 1000)} s at most)"
  end
end
