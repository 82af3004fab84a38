defmodule Aerie.Vehicle.Streams.Check do
  @moduledoc """
  Looks at what comes and decides for each wanted message what its state is, as `Aerie.Vehicle.Streams.Arbiter` describes.
  """

  alias Aerie.Vehicle.Streams.{Arbiter, Line, Meter}

  @every_us 250_000
  # A want that is new is measured only briefly before it is asked for.
  @first_us 1_500_000
  @again_us 500_000
  @retries_us [3_000_000, 10_000_000]
  @tries 3
  @contest_us 120_000_000
  @queries 3
  @query_again_us 600_000_000
  @linger_us 10_000_000
  # When so many streams have too little at once, it is the link.
  @most 0.6

  @doc "What is due at `now`."
  @spec run(Arbiter.t(), integer()) :: Arbiter.t()
  def run(%{checked: checked} = arbiter, now) when checked != nil and now - checked < @every_us, do: arbiter

  def run(arbiter, now) do
    %{arbiter | checked: now} |> groups() |> releases(now) |> lines(now) |> once(now)
  end

  # Groups that clients asked for in the old way are asked for once, and after each reboot.
  defp groups(arbiter) do
    Enum.reduce(arbiter.groups, arbiter, fn {group, hz}, arbiter ->
      if Map.get(arbiter.sent_groups, group, 0) >= hz,
        do: arbiter,
        else: Arbiter.enqueue(arbiter, {:group, group})
    end)
  end

  defp releases(arbiter, now) do
    Enum.reduce(arbiter.releases, arbiter, fn
      {id, nil}, arbiter ->
        %{arbiter | releases: Map.put(arbiter.releases, id, now + @linger_us)}

      {id, due}, arbiter when now >= due ->
        release(%{arbiter | releases: Map.delete(arbiter.releases, id)}, id, arbiter.lines[id])

      _later, arbiter ->
        arbiter
    end)
  end

  defp release(arbiter, id, nil), do: Arbiter.enqueue(arbiter, {:default, id})

  # Somebody may have raised it further than we did: then it is theirs.
  defp release(arbiter, id, line) do
    due = max(line.hz || 0, line.own || line.ask)

    if line.set not in [nil, due] and (line.set > due or line.own != nil) and not line.faster,
      do: ask(arbiter, %{line | ask: due, tries: 0}, id),
      else: arbiter
  end

  defp lines(arbiter, now) do
    Enum.reduce(arbiter.lines, arbiter, fn
      {_id, %{next: nil} = line}, arbiter ->
        begin(arbiter, line, now)

      {id, %{next: next} = line}, arbiter when now >= next ->
        # What is still to be asked for has had no chance yet.
        if {:set, id} in arbiter.queue, do: arbiter, else: judge(arbiter, line, now)

      _later, arbiter ->
        arbiter
    end)
  end

  defp begin(arbiter, line, now) do
    last = Meter.last(arbiter.meter, line.id)
    arbiter = %{arbiter | meter: Meter.watch(arbiter.meter, line.id, now)}
    # What is to come at all and has not is missing at once; all else has to be measured first.
    wait = if line.hz == nil and last == nil and line.state == :new, do: 0, else: long(line)
    line = %{line | next: now + wait}
    if wait == 0, do: judge(arbiter, line, now), else: Arbiter.put_line(arbiter, line)
  end

  defp long(%{state: :new, hz: nil}), do: @first_us
  defp long(%{state: :new, hz: hz}), do: max(@first_us, round(3_000_000 / hz))
  defp long(line), do: Line.window(line)

  defp judge(arbiter, line, now) do
    rate = Meter.rate(arbiter.meter, line.id, now, long(line))
    verdict = Line.judge(line, rate, Meter.last(arbiter.meter, line.id), now)
    line = %{line | rate: rate || line.rate, own: own(line, rate)}

    arbiter =
      if rate, do: %{arbiter | meter: Meter.watch(arbiter.meter, line.id, now)}, else: arbiter

    next = if verdict == :wait, do: @again_us, else: Line.window(line)
    verdict(arbiter, %{line | next: now + next}, verdict, now)
  end

  defp own(%{set: nil}, rate) when rate != nil and rate > 0, do: rate
  defp own(%{own: own}, _rate), do: own

  defp verdict(arbiter, line, :wait, _now), do: Arbiter.put_line(arbiter, line)

  defp verdict(arbiter, %{faster: told} = line, :faster, _now) do
    arbiter = if told, do: arbiter, else: notice(arbiter, line, :faster, line.rate, true)
    Arbiter.put_line(arbiter, %{line | faster: true})
  end

  defp verdict(arbiter, line, :good, _now) do
    arbiter = if line.state == :asked, do: %{arbiter | obeyed: true}, else: arbiter
    Arbiter.put_line(arbiter, %{line | state: :ok, tries: 0, faster: false})
  end

  defp verdict(arbiter, %{state: :new} = line, :short, _now), do: ask(arbiter, line, line.id)

  # Never asked for: it came by itself, and does no more.
  defp verdict(arbiter, %{state: :ok, set: nil} = line, :short, _now), do: ask(arbiter, line, line.id)

  defp verdict(arbiter, %{state: :ok} = line, :short, now), do: query(arbiter, line, now)

  defp verdict(arbiter, %{state: :query} = line, :short, now) do
    # It has not said what is set.
    if link?(arbiter),
      do: Arbiter.put_line(arbiter, %{line | state: :short}),
      else: changed(arbiter, line, line.rate, now)
  end

  # Asked for again because somebody had changed it: have they done it again?
  defp verdict(arbiter, %{state: :asked, resets: [_ | _]} = line, :short, now), do: query(arbiter, line, now)

  defp verdict(arbiter, %{state: :asked, tries: tries} = line, :short, _now) when tries < @tries do
    ask(arbiter, line, line.id)
  end

  defp verdict(arbiter, %{state: :asked} = line, :short, _now) do
    state = if Meter.last(arbiter.meter, line.id), do: :short, else: :missing
    arbiter = Arbiter.put_line(arbiter, %{line | state: state})
    # Who heeds nothing may know only the old way.
    if arbiter.obeyed or arbiter.accepted or arbiter.legacy, do: arbiter, else: legacy(arbiter)
  end

  # Left alone.
  defp verdict(arbiter, line, :short, _now), do: Arbiter.put_line(arbiter, line)

  # A link that comes and goes is not asked about each time.
  defp query(arbiter, line, now) do
    queries = Enum.filter(line.queries, &(now - &1 < @query_again_us))

    if length(queries) < @queries,
      do:
        arbiter
        |> Arbiter.put_line(%{line | state: :query, queries: [now | queries]})
        |> Arbiter.enqueue({:query, line.id}),
      else: Arbiter.put_line(arbiter, %{line | state: :short})
  end

  defp ask(arbiter, line, id) do
    arbiter |> Arbiter.put_line(%{line | state: :asked, tries: line.tries + 1}) |> Arbiter.enqueue({:set, id})
  end

  @doc "How long after a try it is judged (us)."
  @spec wait(Line.t()) :: pos_integer()
  def wait(line), do: max(Enum.at(@retries_us, line.tries - 1, 0), Line.window(line))

  defp legacy(arbiter) do
    ids = for {id, %{state: state}} <- arbiter.lines, state in [:asked, :missing, :short], do: id
    Enum.reduce(ids, %{arbiter | legacy: true}, &Arbiter.enqueue(&2, {:set, &1}))
  end

  @doc "See `Aerie.Vehicle.Streams.Arbiter.interval/4`."
  @spec interval(Arbiter.t(), non_neg_integer(), integer(), integer()) :: Arbiter.t()
  def interval(arbiter, id, interval, at) do
    case arbiter.lines do
      %{^id => %{set: set, state: state} = line} when set != nil and state in [:ok, :query] ->
        cond do
          not Line.as_set?(line, interval) -> changed(arbiter, line, hz(interval), at)
          # It is set as we set it, so it is the link that does not carry it.
          state == :query -> Arbiter.put_line(arbiter, %{line | state: :short})
          true -> arbiter
        end

      _not_ours ->
        arbiter
    end
  end

  defp hz(interval) when interval > 0, do: 1_000_000 / interval
  defp hz(_none), do: 0.0

  # Somebody changed it under us.
  defp changed(arbiter, line, rate, now) do
    resets = [now | Enum.filter(line.resets, &(now - &1 < @contest_us))]
    line = %{line | resets: resets, rate: rate, tries: 0}
    arbiter = %{arbiter | queue: List.delete(arbiter.queue, {:query, line.id})}

    cond do
      # What is set is enough for everybody: it may stay.
      line.hz == nil and rate != nil and rate > 0 -> Arbiter.put_line(arbiter, %{line | state: :ok, set: nil})
      length(resets) < 2 -> ask(arbiter, line, line.id)
      true -> arbiter |> Arbiter.put_line(%{line | state: :yielded}) |> notice(line, :slower, rate, true)
    end
  end

  defp notice(arbiter, line, how, rate, yielded) do
    notice = %{id: line.id, asked: line.set, measured: rate, how: how, yielded: yielded}
    %{arbiter | notices: [notice | arbiter.notices]}
  end

  defp link?(arbiter) do
    states = for {_id, %{set: set, state: state}} <- arbiter.lines, set != nil, do: state
    short = Enum.count(states, &(&1 in [:query, :short]))
    length(states) >= 3 and short >= length(states) * @most
  end

  defp once(arbiter, now) do
    Enum.reduce(arbiter.once, arbiter, fn
      {id, {tries, next}}, arbiter when tries < @tries and (next == nil or now >= next) ->
        next = now + Enum.at(@retries_us, tries, 0)
        Arbiter.enqueue(%{arbiter | once: Map.put(arbiter.once, id, {tries + 1, next})}, {:once, id})

      _known_or_later, arbiter ->
        arbiter
    end)
  end
end
