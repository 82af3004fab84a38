defmodule MavRouter.Signing.Alarm.Burst do
  @many 20
  @window_ms 10_000
  @quiet_ms 60_000

  @moduledoc """
  When refused frames of one source are an alarm: when there are #{@many} within #{div(@window_ms, 1_000)} s, and then every
  #{div(@quiet_ms, 1_000)} s while they last.

  A value, one for each {link, system, component}. Fewer are only counted: PX4 1.18 forwards the frames of other ground stations
  with garbage for a signature, each of them once a second.
  """

  defstruct since: nil, count: 0, told: nil, reasons: %{}

  @type t :: %__MODULE__{
          since: integer | nil,
          count: non_neg_integer,
          told: integer | nil,
          reasons: %{atom => pos_integer}
        }

  @doc "No refused frame yet."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc """
  `n` frames were refused for a reason (monotonic ms): `{:alarm, %{reason => count}}` of this window when an alarm is due.
  """
  @spec add(t, atom, pos_integer, integer) :: {t, :quiet | {:alarm, %{atom => pos_integer}}}
  def add(burst, reason, n, now) do
    burst =
      if burst.since == nil or now - burst.since >= @window_ms,
        do: %{burst | since: now, count: 0, reasons: %{}},
        else: burst

    burst = %{burst | count: burst.count + n, reasons: Map.update(burst.reasons, reason, n, &(&1 + n))}

    if burst.count >= @many and (burst.told == nil or now - burst.told >= @quiet_ms),
      do: {%{burst | told: now}, {:alarm, burst.reasons}},
      else: {burst, :quiet}
  end
end
