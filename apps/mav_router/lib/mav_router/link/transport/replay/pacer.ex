defmodule MavRouter.Link.Transport.Replay.Pacer do
  @moduledoc """
  When a record of a recording is due: a value without a clock.

  Time begins with the first record. A record that is older than its predecessor (two recordings in one file, a clock that
  was set) is due at once, and time continues from it, so that a step back does not stall the replay. So is one that comes more
  than ten minutes after its predecessor: if a clock was set, it would be waited for for decades.
  """

  @gap_us 600_000_000
  # Two links record a little out of order.
  @back_us 2_000_000

  @enforce_keys [:speed]
  defstruct [:speed, :started, :first, :last]

  @typedoc "`speed`: factor of real time or `:max`; times in microseconds: `started`, of the clock; `first`, `last`, recorded"
  @type t :: %__MODULE__{
          speed: float | :max,
          started: integer | nil,
          first: integer | nil,
          last: integer | nil
        }

  @doc "A pacer that has seen no record."
  @spec new(float | :max) :: t
  def new(speed), do: %__MODULE__{speed: speed}

  @doc """
  Whether a record with time `at` is due when the clock shows `now` (both in microseconds): `:due`, or how many
  milliseconds to wait, at least 1. `{:jump, microseconds}`: it is due at once, because time does not go on from the record before.
  """
  @spec schedule(t, at :: integer, now :: integer) :: {:due | {:jump, integer} | pos_integer, t}
  def schedule(%__MODULE__{first: nil} = pacer, at, now), do: {:due, begin(pacer, at, now)}

  def schedule(%__MODULE__{last: last} = pacer, at, now) when at < last - @back_us or at - last > @gap_us,
    do: {{:jump, at - last}, begin(pacer, at, now)}

  def schedule(%__MODULE__{speed: :max} = pacer, at, _now), do: {:due, %{pacer | last: at}}
  def schedule(%__MODULE__{last: last} = pacer, at, now) when at < last, do: {:due, begin(pacer, at, now)}

  def schedule(%__MODULE__{} = pacer, at, now) do
    early = (at - pacer.first) / pacer.speed - (now - pacer.started)
    if early <= 0, do: {:due, %{pacer | last: at}}, else: {ceil(early / 1000), pacer}
  end

  defp begin(pacer, at, now), do: %{pacer | started: now, first: at, last: at}
end
