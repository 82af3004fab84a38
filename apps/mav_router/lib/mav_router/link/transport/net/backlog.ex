defmodule MavRouter.Link.Transport.Net.Backlog do
  @every_ms 50

  @moduledoc """
  How old the datagrams are that wait for a link, and how many of them to discard: a value.

  A socket keeps the oldest datagrams and drops the newest, so a link that does not keep up would show a state that is
  seconds old for as long as the overload lasts. Instead, when what waits would take half a second to read at the pace
  of the last #{@every_ms} ms, datagrams are discarded until a quarter of a second is left. A burst, or a machine that
  was busy for a moment, is not an overload: discarding begins when this has lasted for a second, and the overload
  ends when for two seconds no more waited than those that are left.

  The pace is what was read in the time since the last measurement, a discarded datagram counted for what it costs (a
  twentieth of a kept one), if others waited all the time. If nothing was left, the link waited for datagrams, and
  only the time in which it passed on those it had counts. A pace of what was kept, or of what came, would feed on its
  own result. At least one datagram of a read is kept.

  It is fair to senders (`MavRouter.Link.Transport.Net.Senders`). It first keeps those of the datagrams read at a time
  whose senders had been heard for a minute when the overload began, then those of senders heard for five seconds, then
  those of new ones: hundreds of strangers take nothing from a vehicle that was there before. Among equals each sender
  keeps its newest heartbeat, by which a vehicle is known, then as many others as those that have so many, its newest.
  """

  alias MavRouter.Link.Transport.Net.Senders

  @late_ms 500
  @keep_ms 250
  @patience_ms 1_000
  @relief_ms 2_000
  # So many are discarded in the time in which one is passed on.
  @discards 20
  # Fewer datagrams than this are not a backlog.
  @some 64
  @many 256
  # What is read beyond one batch was left by a link whose time others took. It keeps an eighth of that, up to another
  # batch: at the pace of the few that it kept before, it would keep fewer and fewer.
  @batch 128
  @most_of 8
  # And of that, a few of each sender that was heard before: one frame that wakes its vehicle's session costs as much
  # as these.
  @each 4
  # The kernel's room in an overload: so many times what is kept, and never less.
  @choice 4
  @least 1_024

  # How long a sender was heard before the overload, for each rank.
  @known_ms [5_000, 60_000]

  defstruct measured: nil,
            waiting: 0,
            keep: {0, 1},
            done: 0,
            lost: 0,
            reads: 0,
            passed: nil,
            shed: 0,
            late: nil,
            strained: nil,
            began: nil,
            senders: Senders.new()

  @typedoc """
  - `shed`: of how many of the next datagrams to discard some; `keep`: so many of so many are kept
  - `measured`: monotonic ms of the last measurement; `waiting`: how many waited then; `done`, `lost`: how many were
    kept and discarded since, in so many `reads`; `passed`: when the last of them had been passed on, if that is known
  - `late`: since when too many have been waiting; `strained`: when more waited than are left, in an overload that has
    begun; `began`: when it began
  """
  @type t :: %__MODULE__{
          measured: integer | nil,
          waiting: non_neg_integer,
          keep: {non_neg_integer, of :: pos_integer},
          done: non_neg_integer,
          lost: non_neg_integer,
          reads: non_neg_integer,
          passed: integer | nil,
          shed: non_neg_integer,
          late: integer | nil,
          strained: integer | nil,
          began: integer | nil,
          senders: Senders.t()
        }

  @typedoc "How many were discarded: of senders that had been heard before the overload, and of new ones."
  @type discarded :: %{shed: non_neg_integer, shed_new: non_neg_integer}

  @none %{shed: 0, shed_new: 0}

  @doc "Nothing waits."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc """
  Whether to measure what waits. At every read while there are too many: one read more than necessary is 128
  datagrams.
  """
  @spec due?(t, integer) :: boolean
  def due?(%__MODULE__{measured: nil}, _now), do: true

  def due?(%__MODULE__{measured: at, shed: shed} = backlog, now),
    do: shed > 0 or now - at >= @every_ms or (backlog.strained != nil and backlog.waiting > some(backlog))

  @doc "Takes the measurement that so many wait at `now`, those included that are taken next."
  @spec measure(t, non_neg_integer, integer) :: t
  def measure(%__MODULE__{shed: shed} = backlog, waiting, now) when shed > 0 do
    left = if waiting > some(backlog), do: min(shed, waiting), else: 0
    %{next(backlog, waiting, now) | shed: left}
  end

  def measure(%__MODULE__{waiting: before} = backlog, waiting, now) do
    some = some(backlog)
    ms = if before > some and waiting > some, do: busy_ms(backlog, now)
    per_ms = if ms, do: (backlog.done + backlog.lost / @discards) / max(ms, 1), else: :idle
    backlog |> next(waiting, now) |> evaluate(per_ms, now)
  end

  defp busy_ms(%{measured: nil}, _now), do: nil

  defp busy_ms(%{waiting: before, done: done, lost: lost} = b, now) when before > done + lost,
    do: now - b.measured

  defp busy_ms(%{reads: 1, passed: at} = backlog, _now) when at != nil, do: at - backlog.measured
  defp busy_ms(_idle, _now), do: nil

  defp next(backlog, waiting, now),
    do: %{backlog | measured: now, waiting: waiting, done: 0, lost: 0, reads: 0, passed: nil}

  # In an overload a link may be so slow that these few are seconds.
  defp some(%{strained: nil}), do: @some
  defp some(_strained), do: 0

  defp evaluate(%{waiting: waiting} = backlog, per_ms, now)
       when per_ms == :idle or waiting <= per_ms * @late_ms do
    short? = per_ms == :idle or waiting <= per_ms * @keep_ms
    relieved(%{backlog | late: nil}, short?, now)
  end

  defp evaluate(%{strained: strained} = backlog, per_ms, now) do
    backlog = %{backlog | late: backlog.late || now, began: backlog.began || now}

    keep = {max(round(per_ms * @keep_ms), 1), backlog.waiting}

    if strained != nil or now - backlog.late >= @patience_ms,
      do: %{backlog | strained: now, shed: backlog.waiting, keep: keep},
      else: backlog
  end

  defp relieved(%{strained: nil} = backlog, _short?, _now), do: %{backlog | began: nil}
  defp relieved(backlog, false, now), do: %{backlog | strained: now}
  defp relieved(%{strained: at} = backlog, true, now) when now - at < @relief_ms, do: backlog
  defp relieved(backlog, true, _now), do: %{backlog | strained: nil, began: nil}

  @doc "Whether an overload has begun and is not over."
  @spec strained?(t) :: boolean
  def strained?(%__MODULE__{strained: at}), do: at != nil

  @doc """
  For how many datagrams the kernel is to have room: in an overload for #{@choice} times as many as are kept of them,
  and at least #{@least}. What more it held would only be read to be discarded, which a gateway without a processor of
  its own would do all the time.
  """
  @spec room(t) :: pos_integer | :most
  def room(%__MODULE__{strained: nil}), do: :most
  def room(%__MODULE__{keep: {keep, _of}}) when is_integer(keep), do: max(@choice * keep, @least)

  @doc "Whether to say when the datagrams taken last have been passed on (`passed/2`): while some wait."
  @spec timed?(t) :: boolean
  def timed?(backlog), do: backlog.waiting > some(backlog)

  @doc "The datagrams taken last were passed on by `now`."
  @spec passed(t, integer) :: t
  def passed(backlog, now), do: %{backlog | passed: now}

  @doc "The kept ones of the datagrams that were read, in order, and the number of discarded ones."
  @spec take(t, [{term, binary}]) :: {[{term, binary}], discarded, t}
  def take(%__MODULE__{shed: 0} = backlog, datagrams),
    do: {datagrams, @none, backlog |> counted(length(datagrams), 0) |> noted(datagrams)}

  def take(%__MODULE__{shed: shed, keep: {keep, of}} = backlog, datagrams) do
    backlog = noted(backlog, datagrams)
    n = length(datagrams)
    {groups, known, new} = groups(datagrams, backlog)
    left = n - @batch
    least = max(min(div(left, @most_of), @batch), min(@each * known, left))
    # The same part of each read, so that what is kept is not of one moment; rounded up.
    keep = n |> Kernel.*(keep) |> Kernel./(of) |> ceil() |> max(least) |> min(n)

    # Senders that were there before, if they are few, do not pay for a pace that was low for a moment. Where very
    # many wait it was low for longer.
    extra = if of <= @many, do: n, else: keep
    most = keep + min(extra, max(div(n + 3, 4) - keep, 0))
    kept = max(keep, min(most, n - new))
    lost = n - kept
    lost_new = min(new, lost)
    backlog = counted(%{backlog | shed: max(shed - n, 0)}, kept, lost)
    {first(groups, kept), %{shed: lost - lost_new, shed_new: lost_new}, backlog}
  end

  defp counted(backlog, kept, lost),
    do: %{backlog | done: backlog.done + kept, lost: backlog.lost + lost, reads: backlog.reads + 1}

  # Groups to keep one before the other: by the rank of their senders, the newest heartbeat of each, then each sender's
  # newest before any other's second newest. Within a group the oldest is first. Sorting them all costs more than to
  # read them.
  defp groups(datagrams, backlog) do
    {groups, rounds, new, _i} =
      datagrams
      |> Enum.reverse()
      |> Enum.reduce({%{}, %{}, 0, 0}, fn datagram, {groups, rounds, new, i} ->
        sender = Senders.of(datagram)
        {rank, round, beat?} = Map.get_lazy(rounds, sender, fn -> {-rank(backlog, sender), 0, false} end)
        new = if rank == 0, do: new + 1, else: new

        {key, noted} =
          if not beat? and heartbeat?(datagram),
            do: {{rank, -1}, {rank, round, true}},
            else: {{rank, round}, {rank, round + 1, beat?}}

        groups = Map.update(groups, key, [{i, datagram}], &[{i, datagram} | &1])
        {groups, Map.put(rounds, sender, noted), new, i - 1}
      end)

    known = Enum.count(rounds, &match?({_sender, {rank, _round, _beat?}} when rank < 0, &1))
    {groups |> Enum.sort() |> Enum.map(&elem(&1, 1)), known, new}
  end

  # So many of the first groups, of the last of them the newest, in the order in which they came.
  defp first(groups, kept) do
    groups
    |> Enum.flat_map_reduce(kept, fn
      _group, 0 -> {:halt, 0}
      group, room -> with(group = Enum.take(group, -room), do: {group, room - length(group)})
    end)
    |> elem(0)
    |> List.keysort(0)
    |> Enum.map(&elem(&1, 1))
  end

  defp heartbeat?({_address, <<0xFD, _::48, 0::24, _::binary>>}), do: true
  defp heartbeat?({_address, <<0xFE, _::32, 0, _::binary>>}), do: true
  defp heartbeat?(_other), do: false

  defp rank(%{began: began, senders: senders}, sender) do
    since = Senders.since(senders, sender)
    if since && began, do: Enum.count(@known_ms, &(began - since >= &1)), else: 0
  end

  defp noted(%{measured: nil} = backlog, _datagrams), do: backlog

  defp noted(backlog, datagrams),
    do: %{backlog | senders: Senders.note(backlog.senders, datagrams, backlog.measured)}
end
