defmodule Aerie.Link.Backlog do
  @every_ms 50

  @moduledoc """
  How old the datagrams are that wait for a link, and how many of them to discard: a value.

  A socket keeps the oldest datagrams and drops the newest, so a link that does not keep up would show a state that is
  seconds old for as long as the overload lasts. Instead, when what waits would take half a second to read at the pace of the
  last #{@every_ms} ms, the oldest datagrams are discarded until a tenth of a second is left. A burst, or a machine that was busy for a
  moment, is no overload: discarding begins when this has lasted for a second, and ends after five seconds without it.
  """

  @late_ms 500
  @keep_ms 100
  @patience_ms 1_000
  @relief_ms 5_000
  # Fewer datagrams than this are no backlog.
  @some 64

  defstruct measured: nil, waiting: 0, done: 0, shed: 0, late: nil, strained: nil

  @typedoc """
  - `shed`: how many of the next datagrams to discard
  - `measured`: monotonic ms of the last measurement; `waiting`: how many waited then; `done`: how many were read since
  - `late`: since when too many have been waiting; `strained`: when that was last so, in an overload that has begun
  """
  @type t :: %__MODULE__{
          measured: integer | nil,
          waiting: non_neg_integer,
          done: non_neg_integer,
          shed: non_neg_integer,
          late: integer | nil,
          strained: integer | nil
        }

  @doc "Nothing waits."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether to measure what waits. At every read while datagrams are discarded, so that not more are than necessary."
  @spec due?(t, integer) :: boolean
  def due?(%__MODULE__{measured: nil}, _now), do: true
  def due?(%__MODULE__{measured: at, shed: shed}, now), do: shed > 0 or now - at >= @every_ms

  @doc "Takes the measurement that so many wait at `now`."
  @spec measure(t, non_neg_integer, integer) :: t
  # Discarded datagrams are not read: the pace is known again after the next measurement.
  def measure(%__MODULE__{shed: shed} = backlog, waiting, now) when shed > 0 do
    left = if waiting > @some, do: min(shed, waiting), else: 0
    %{backlog | measured: now, waiting: 0, done: 0, shed: left}
  end

  # How much was read is the pace only if datagrams waited all the time.
  def measure(%__MODULE__{measured: at, waiting: before} = backlog, waiting, now) do
    busy? = at != nil and before > @some and waiting > @some
    excess = if busy?, do: excess(waiting, backlog.done / max(now - at, 1)), else: 0
    judge(%{backlog | measured: now, waiting: waiting, done: 0}, excess, now)
  end

  defp judge(%{strained: strained} = backlog, 0, now) do
    over? = strained != nil and now - strained >= @relief_ms
    %{backlog | late: nil, strained: if(over?, do: nil, else: strained)}
  end

  defp judge(%{late: late, strained: strained} = backlog, excess, now) do
    late = late || now

    if strained != nil or now - late >= @patience_ms,
      do: %{backlog | late: late, strained: now, shed: excess},
      else: %{backlog | late: late}
  end

  defp excess(waiting, per_ms) when waiting > per_ms * @late_ms, do: round(waiting - per_ms * @keep_ms)
  defp excess(_waiting, _per_ms), do: 0

  @doc "What is left of the datagrams that were read, the oldest first, and how many were discarded."
  @spec take(t, [datagram]) :: {[datagram], non_neg_integer, t} when datagram: term
  def take(%__MODULE__{shed: 0} = backlog, datagrams),
    do: {datagrams, 0, %{backlog | done: backlog.done + length(datagrams)}}

  def take(%__MODULE__{shed: shed} = backlog, datagrams) do
    {late, rest} = Enum.split(datagrams, shed)
    n = length(late)
    {rest, n, %{backlog | shed: shed - n, done: backlog.done + length(rest)}}
  end
end
