defmodule Aerie.Link.Backlog do
  @moduledoc """
  How old the datagrams are that wait for a link, and how many of them to throw away: a value.

  A socket keeps the oldest and drops the newest, so a link that does not keep up shows what was, seconds ago, for as long
  as that lasts. Instead, when what waits would take half a second to read at the pace of the last #{50} ms, the oldest go
  until a tenth of a second is left. A burst, or a machine that was busy for a moment, is no overload: only when it is so for
  a second does that begin, and it ends when it was not so for five.
  """

  @every_ms 50
  @late_ms 500
  @keep_ms 100
  @patience_ms 1_000
  @relief_ms 5_000
  # Fewer are no backlog.
  @some 64

  defstruct looked: nil, waiting: 0, done: 0, shed: 0, late: nil, strained: nil

  @typedoc """
  `shed`: how many of the next datagrams are to be thrown away; `done`: read since it was `looked` (monotonic ms); `late`:
  since when too much has been waiting; `strained`: when that was so last, of an overload that has begun
  """
  @type t :: %__MODULE__{
          looked: integer | nil,
          waiting: non_neg_integer,
          done: non_neg_integer,
          shed: non_neg_integer,
          late: integer | nil,
          strained: integer | nil
        }

  @doc "Nothing waits."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether it is time to look at what waits. Sooner while datagrams are thrown away, so that none go that need not."
  @spec due?(t, integer) :: boolean
  def due?(%__MODULE__{looked: nil}, _now), do: true
  def due?(%__MODULE__{looked: looked, shed: shed}, now), do: shed > 0 or now - looked >= @every_ms

  @doc "So many wait at `now`."
  @spec look(t, non_neg_integer, integer) :: t
  # What is being thrown away is not read: the pace is known again after the next look.
  def look(%__MODULE__{shed: shed} = backlog, waiting, now) when shed > 0 do
    left = if waiting > @some, do: min(shed, waiting), else: 0
    %{backlog | looked: now, waiting: 0, done: 0, shed: left}
  end

  # Only while something waited all the time does what was read tell the pace.
  def look(%__MODULE__{looked: looked, waiting: before} = backlog, waiting, now) do
    busy? = looked != nil and before > @some and waiting > @some
    excess = if busy?, do: excess(waiting, backlog.done / max(now - looked, 1)), else: 0
    judge(%{backlog | looked: now, waiting: waiting, done: 0}, excess, now)
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

  @doc "What is left of datagrams that were taken, the oldest first, and how many were thrown away."
  @spec take(t, [datagram]) :: {[datagram], non_neg_integer, t} when datagram: term
  def take(%__MODULE__{shed: 0} = backlog, datagrams),
    do: {datagrams, 0, %{backlog | done: backlog.done + length(datagrams)}}

  def take(%__MODULE__{shed: shed} = backlog, datagrams) do
    {late, rest} = Enum.split(datagrams, shed)
    n = length(late)
    {rest, n, %{backlog | shed: shed - n, done: backlog.done + length(rest)}}
  end
end
