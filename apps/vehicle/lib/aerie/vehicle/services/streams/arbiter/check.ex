defmodule Aerie.Vehicle.Services.Streams.Arbiter.Check do
  @moduledoc """
  Decides the state of each wanted message by what comes, as `Aerie.Vehicle.Services.Streams.Arbiter` describes.
  """

  alias Aerie.Vehicle.Services.Streams.{Arbiter, Meter, WantedMessage}
  alias Aerie.Vehicle.Services.Streams.Arbiter.Groups

  @every_us 250_000
  # A new demand is measured only briefly before it is requested.
  @first_us 1_500_000
  @again_us 500_000
  @tries 3
  @contest_us 120_000_000
  @queries 3
  @query_again_us 600_000_000
  @linger_us 10_000_000
  # If this share of all streams is too slow at once, the link is.
  @most 0.6

  @doc "Does what is due at `now`."
  @spec run(Arbiter.t(), integer()) :: Arbiter.t()
  def run(%{checked_at: at} = arbiter, now) when at != nil and now - at < @every_us, do: arbiter

  def run(arbiter, now) do
    %{arbiter | checked_at: now} |> Groups.check(now) |> resets(now) |> messages(now) |> once(now)
  end

  defp resets(arbiter, now) do
    Enum.reduce(arbiter.resets, arbiter, fn
      {id, nil}, arbiter ->
        %{arbiter | resets: Map.put(arbiter.resets, id, now + @linger_us)}

      {what, due}, arbiter when now >= due ->
        reset(%{arbiter | resets: Map.delete(arbiter.resets, what)}, what, arbiter.messages[what])

      _later, arbiter ->
        arbiter
    end)
  end

  defp reset(arbiter, {:group, group}, _), do: Groups.reset(arbiter, group)
  defp reset(arbiter, id, nil), do: Arbiter.enqueue(arbiter, {:default, id})

  # If another program has raised the rate further than we did, it stays.
  defp reset(arbiter, id, wanted) do
    hz = WantedMessage.least(wanted)

    if wanted.set not in [nil, hz] and (wanted.set > hz or wanted.initial != nil) and not wanted.faster,
      do: ask(arbiter, %{wanted | ask: hz, tries: 0}, id),
      else: arbiter
  end

  defp messages(arbiter, now) do
    due =
      for {id, %{next: next} = wanted} <- Map.to_list(arbiter.messages),
          next == nil or now >= next,
          do: {id, wanted}

    Enum.reduce(due, arbiter, fn
      {_id, %{next: nil} = wanted}, arbiter ->
        begin(arbiter, wanted, now)

      {id, wanted}, arbiter ->
        # A request that is still queued cannot have had an effect.
        if {:set, id} in arbiter.queue, do: arbiter, else: evaluate(arbiter, wanted, now)
    end)
  end

  defp begin(arbiter, wanted, now) do
    last = Meter.last(arbiter.meter, wanted.id)
    arbiter = %{arbiter | meter: Meter.watch(arbiter.meter, wanted.id, now)}

    # A message that is wanted at any rate and never came is missing at once; others have to be measured first.
    wait = if wanted.hz == nil and last == nil and wanted.state == :new, do: 0, else: long(wanted)
    wanted = %{wanted | next: now + wait}
    if wait == 0, do: evaluate(arbiter, wanted, now), else: Arbiter.put(arbiter, wanted)
  end

  defp long(%{state: :new, hz: nil}), do: @first_us
  defp long(%{state: :new, hz: hz}), do: max(@first_us, round(3_000_000 / hz))
  defp long(wanted), do: WantedMessage.window(wanted)

  defp evaluate(arbiter, wanted, now) do
    rate = Meter.rate(arbiter.meter, wanted.id, now, long(wanted))
    verdict = WantedMessage.evaluate(wanted, rate, Meter.last(arbiter.meter, wanted.id), now)
    wanted = %{wanted | rate: rate || wanted.rate, initial: initial(wanted, rate)}

    arbiter =
      if rate, do: %{arbiter | meter: Meter.watch(arbiter.meter, wanted.id, now)}, else: arbiter

    next = if verdict == :wait, do: @again_us, else: WantedMessage.window(wanted)
    verdict(arbiter, %{wanted | next: now + next}, verdict, now)
  end

  defp initial(%{set: nil}, rate) when rate != nil and rate > 0, do: rate
  defp initial(%{initial: initial}, _rate), do: initial

  defp verdict(arbiter, wanted, :wait, _now), do: Arbiter.put(arbiter, wanted)

  # What a link held back comes all at once, so the vehicle is asked.
  defp verdict(arbiter, %{faster: false} = wanted, :faster, now), do: query(arbiter, wanted, now, :ok)
  defp verdict(arbiter, wanted, :faster, _now), do: Arbiter.put(arbiter, wanted)

  defp verdict(arbiter, wanted, :good, _now) do
    arbiter = if wanted.state == :asked, do: %{arbiter | obeyed: true}, else: arbiter
    Arbiter.put(arbiter, %{wanted | state: :ok, tries: 0, faster: false})
  end

  defp verdict(arbiter, %{state: :new} = wanted, :short, _now), do: ask(arbiter, wanted, wanted.id)

  # It was never requested: it came by itself, and now it does not.
  defp verdict(arbiter, %{state: :ok, set: nil} = wanted, :short, _now), do: ask(arbiter, wanted, wanted.id)

  defp verdict(arbiter, %{state: :ok} = wanted, :short, now), do: query(arbiter, wanted, now)

  defp verdict(arbiter, %{state: :query} = wanted, :short, now) do
    # The vehicle has not answered.
    if slow_link?(arbiter),
      do: Arbiter.put(arbiter, %{wanted | state: :short}),
      else: changed(arbiter, wanted, wanted.rate, now, :measured)
  end

  # It was requested again because another program had changed it. Has it been changed once more?
  defp verdict(arbiter, %{state: :asked, changes: [_ | _]} = wanted, :short, now),
    do: query(arbiter, wanted, now)

  defp verdict(arbiter, %{state: :asked, tries: tries} = wanted, :short, _now) when tries < @tries do
    ask(arbiter, wanted, wanted.id)
  end

  defp verdict(arbiter, %{state: :asked} = wanted, :short, _now) do
    state = if Meter.last(arbiter.meter, wanted.id), do: :short, else: :missing
    arbiter = Arbiter.put(arbiter, %{wanted | state: state})
    # A vehicle that obeys nothing may know only REQUEST_DATA_STREAM.
    if arbiter.obeyed or arbiter.accepted or arbiter.legacy, do: arbiter, else: legacy(arbiter)
  end

  # Nothing more is sent.
  defp verdict(arbiter, wanted, :short, _now), do: Arbiter.put(arbiter, wanted)

  # Bounded, because a link may come and go.
  defp query(arbiter, wanted, now, otherwise \\ :short) do
    queries = Enum.filter(wanted.queries, &(now - &1 < @query_again_us))

    if length(queries) < @queries,
      do:
        arbiter
        |> Arbiter.put(%{wanted | state: :query, queries: [now | queries]})
        |> Arbiter.enqueue({:query, wanted.id}),
      else: Arbiter.put(arbiter, %{wanted | state: otherwise})
  end

  defp ask(arbiter, wanted, id) do
    arbiter |> Arbiter.put(%{wanted | state: :asked, tries: wanted.tries + 1}) |> Arbiter.enqueue({:set, id})
  end

  defp legacy(arbiter) do
    ids = for {id, %{state: state}} <- arbiter.messages, state in [:asked, :missing, :short], do: id
    Enum.reduce(ids, %{arbiter | legacy: true}, &Arbiter.enqueue(&2, {:set, &1}))
  end

  @doc "See `Aerie.Vehicle.Services.Streams.Arbiter.interval/4`."
  @spec interval(Arbiter.t(), non_neg_integer(), integer(), integer()) :: Arbiter.t()
  def interval(arbiter, id, interval, at) do
    case arbiter.messages do
      %{^id => %{set: set, state: state} = wanted} when set != nil and state in [:ok, :query] ->
        cond do
          not WantedMessage.as_set?(wanted, interval) -> changed(arbiter, wanted, hz(interval), at, :told)
          WantedMessage.raised?(wanted, hz(interval)) -> raised(arbiter, wanted, hz(interval))
          # The interval is ours: it is the link that is too slow, or made up for a pause.
          state == :query -> Arbiter.put(arbiter, %{wanted | state: if(slow?(wanted), do: :short, else: :ok)})
          true -> arbiter
        end

      _not_ours ->
        arbiter
    end
  end

  defp hz(interval) when interval > 0, do: 1_000_000 / interval
  defp hz(_none), do: 0.0

  defp slow?(%{rate: rate, set: set}), do: rate == nil or rate < set

  defp raised(arbiter, %{faster: true} = wanted, _rate), do: Arbiter.put(arbiter, %{wanted | state: :ok})

  defp raised(arbiter, wanted, rate),
    do: arbiter |> Arbiter.put(%{wanted | state: :ok, faster: true}) |> notice(wanted, :faster, rate, true)

  # Another program changed the rate. Only the vehicle's word for that is reported, as a link that loses data looks the
  # same.
  defp changed(arbiter, wanted, rate, now, how) do
    changes = [now | Enum.filter(wanted.changes, &(now - &1 < @contest_us))]
    wanted = %{wanted | changes: changes, rate: rate, tries: 0}
    arbiter = %{arbiter | queue: List.delete(arbiter.queue, {:query, wanted.id})}

    cond do
      # Any rate will do, so this one may stay.
      wanted.hz == nil and rate != nil and rate > 0 -> Arbiter.put(arbiter, %{wanted | state: :ok, set: nil})
      length(changes) < 2 -> ask(arbiter, wanted, wanted.id)
      how == :measured -> Arbiter.put(arbiter, %{wanted | state: :short})
      true -> arbiter |> Arbiter.put(%{wanted | state: :yielded}) |> notice(wanted, :slower, rate, true)
    end
  end

  defp notice(arbiter, wanted, how, rate, yielded) do
    notice = %{id: wanted.id, asked: wanted.set, measured: rate, how: how, yielded: yielded}
    %{arbiter | notices: [notice | arbiter.notices]}
  end

  defp slow_link?(arbiter) do
    states = for {_id, %{set: set, state: state}} <- arbiter.messages, set != nil, do: state
    short = Enum.count(states, &(&1 in [:query, :short]))
    length(states) >= 3 and short >= length(states) * @most
  end

  defp once(arbiter, now) do
    Enum.reduce(arbiter.once, arbiter, fn
      {id, {tries, next}}, arbiter when tries < @tries and (next == nil or now >= next) ->
        next = now + WantedMessage.retry_us(tries)
        Arbiter.enqueue(%{arbiter | once: Map.put(arbiter.once, id, {tries + 1, next})}, {:once, id})

      _known_or_later, arbiter ->
        arbiter
    end)
  end
end
