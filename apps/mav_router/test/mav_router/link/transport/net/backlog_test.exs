defmodule MavRouter.Link.Transport.Net.BacklogTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias MavRouter.Link.Transport.Net.Backlog

  # A link that reads `pace` datagrams a ms while `rate` a ms come from one sender, beside those that wait at first.
  defp play(pace, rate, backlog_at_start, seconds \\ 3) do
    hear(seconds, pace * 1_000, fn now ->
      List.duplicate(:one, if(now == 1, do: rate + backlog_at_start, else: rate))
    end)
  end

  # A link that reads `budget` datagrams in a second, while `send` says who sends in each ms, for so many seconds:
  # what each sender sent, what was read of it, how old what was read after three seconds was, and what is left. Reads
  # are of at most 128 datagrams, which it cannot leave half done, and discarding costs a twentieth of reading.
  defp hear(seconds, budget, send) do
    state = %{
      backlog: Backlog.new(),
      queue: :queue.new(),
      credit: 0,
      passing?: false,
      sent: %{},
      read: %{},
      age: 0,
      shed: 0,
      shed_new: 0
    }

    Enum.reduce(1..(seconds * 1000), state, fn now, state ->
      senders = send.(now)
      queue = Enum.reduce(senders, state.queue, &:queue.in({&1, <<now::64>>}, &2))
      sent = Enum.reduce(senders, state.sent, fn sender, sent -> Map.update(sent, sender, 1, &(&1 + 1)) end)
      state = passed(%{state | queue: queue, sent: sent, credit: min(state.credit, 20_000) + budget}, now)
      spend(state, now)
    end)
  end

  # What was read has been passed on once it is paid for.
  defp passed(%{passing?: true, credit: credit} = state, now) when credit > 0,
    do: %{state | passing?: false, backlog: Backlog.passed(state.backlog, now)}

  defp passed(state, _now), do: state

  defp spend(%{credit: credit} = state, now) do
    n = min(128, :queue.len(state.queue))

    if n == 0 or credit < 1_000 do
      state
    else
      state = passed(state, now)
      {taken, rest} = :queue.split(n, state.queue)

      backlog =
        if Backlog.due?(state.backlog, now),
          do: Backlog.measure(state.backlog, :queue.len(state.queue), now),
          else: state.backlog

      {read, %{shed: shed, shed_new: new}, backlog} = Backlog.take(backlog, :queue.to_list(taken))
      heard = Enum.reduce(read, state.read, fn {sender, _}, all -> Map.update(all, sender, 1, &(&1 + 1)) end)
      age = for {_, <<at::64>>} <- read, now > 3_000, reduce: state.age, do: (age -> max(age, now - at))

      spend(
        %{
          state
          | backlog: backlog,
            queue: rest,
            passing?: Backlog.timed?(backlog),
            credit: credit - 1_000 * length(read) - 50 * (shed + new),
            read: heard,
            age: age,
            shed: state.shed + shed,
            shed_new: state.shed_new + new
        },
        now
      )
    end
  end

  defp every(now, ms, sender), do: if(rem(now, ms) == 0, do: [sender], else: [])
  defp share(heard, sender), do: Map.get(heard.read, sender, 0) / heard.sent[sender]
  defp discarded(heard), do: heard.shed + heard.shed_new

  test "a link that keeps up discards nothing, whatever waited at first; nor does one that was held up for a moment" do
    for waiting <- [0, 10, 1_000], do: assert(discarded(play(10, 9, waiting)) == 0)
    # Late for less than a second.
    assert discarded(play(5, 1, 5_000, 2)) == 0
  end

  test "a link that does not keep up reads young datagrams, and discards only what was too much" do
    played = play(5, 10, 0, 6)
    assert played.age <= 700
    assert discarded(played) in 15_000..38_000
    assert :queue.len(played.queue) + discarded(played) + played.read.one == 60_000
  end

  test "old datagrams are discarded" do
    played = play(5, 4, 20_000, 6)
    assert discarded(played) > 8_000
    assert played.age <= 700
  end

  test "every datagram is read or counted" do
    property =
      :proper.forall(list({range(0, 200), range(1, 100), range(0, 5_000)}), fn steps ->
        {_now, _backlog, same?} =
          Enum.reduce(steps, {0, Backlog.new(), true}, fn {n, ms, waiting}, {now, backlog, same?} ->
            now = now + ms
            backlog = if Backlog.due?(backlog, now), do: Backlog.measure(backlog, waiting, now), else: backlog
            datagrams = for i <- 1..n//1, do: {rem(i * i, 7), <<0xFD, 0::32, rem(i, 3), i::16>>}
            {read, discarded, backlog} = Backlog.take(backlog, datagrams)
            # In their order, none twice, and none made up.
            whole? = length(read) + discarded.shed + discarded.shed_new == n
            in_order? = Enum.filter(datagrams, &(&1 in read)) == read
            {now, backlog, same? and whole? and in_order? and backlog.shed >= 0}
          end)

        same?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  # One read of `n` datagrams while `waiting` wait; how many were kept.
  defp read(backlog, now, waiting, n, senders \\ 4) do
    backlog = if Backlog.due?(backlog, now), do: Backlog.measure(backlog, waiting, now), else: backlog
    datagrams = for i <- 1..n//1, do: {{:vehicle, rem(i, senders)}, <<0xFD, 0::32, rem(i, senders)>>}
    {kept, _discarded, backlog} = Backlog.take(backlog, datagrams)
    {length(kept), backlog}
  end

  # A processor that is free: what waits is read at once, then `burst` datagrams every `ms`, all that came at each
  # read. What was lost after the first two seconds.
  defp free(backlog, now, waiting, {burst, ms}) do
    {backlog, now} =
      Enum.reduce_while(Stream.iterate(waiting, &(&1 - 128)), {backlog, now}, fn
        left, {backlog, now} when left <= 0 -> {:halt, {backlog, now}}
        left, {backlog, now} -> {:cont, {backlog |> read(now + 1, left, min(left, 128)) |> elem(1), now + 1}}
      end)

    steps = div(10_000, ms)

    {_backlog, lost} =
      Enum.reduce(1..steps, {backlog, 0}, fn i, {backlog, lost} ->
        {kept, backlog} = read(backlog, now + i * ms, burst, burst)
        {backlog, if(i * ms > 2_000, do: lost + burst - kept, else: lost)}
      end)

    lost
  end

  # A link that was short of a processor just after its vehicles appeared: every datagram was read afterwards, and
  # none passed on.
  for fine_s <- [2, 10, 70], reads <- [3, 5, 8], n <- [1, 2, 8] do
    test "after #{fine_s} s and #{reads} slow reads of #{n} while hundreds wait, a free processor loses nothing" do
      {backlog, now} =
        Enum.reduce(1..(unquote(fine_s) * 100), {Backlog.new(), 0}, fn _i, {backlog, now} ->
          {backlog |> read(now, 10, 10) |> elem(1), now + 10}
        end)

      {backlog, now} =
        Enum.reduce(1..unquote(reads), {backlog, now}, fn i, {backlog, now} ->
          {backlog |> read(now, 600 * i, unquote(n)) |> elem(1), now + 600}
        end)

      assert free(backlog, now, 5_000, {10, 10}) == 0
    end
  end

  test "whatever went before, a link with a free processor loses nothing after two seconds" do
    step = {range(0, 128), range(1, 2_000), range(0, 5_000), range(0, 1)}

    property =
      :proper.forall({list(step), range(1, 128), range(1, 1_000)}, fn {steps, burst, ms} ->
        {backlog, now, waiting} =
          Enum.reduce(steps, {Backlog.new(), 0, 0}, fn {n, ms, waiting, passed}, {backlog, now, _waiting} ->
            {_kept, backlog} = read(backlog, now, max(waiting, n), n)
            now = now + ms
            {if(passed == 1, do: Backlog.passed(backlog, now), else: backlog), now, waiting}
          end)

        free(backlog, now, waiting, {burst, ms}) == 0
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500, max_size: 60]) == true,
           inspect(:proper.counterexample())
  end

  test "a burst every second is not an overload, though more than wait otherwise" do
    backlog = Enum.reduce(1..30, Backlog.new(), &(&2 |> read(&1 * 1_000, 120, 120) |> elem(1)))
    assert {120, backlog} = read(backlog, 31_000, 120, 120)
    assert backlog.strained == nil
  end

  test "at least one datagram of a read is kept" do
    starved = Enum.reduce(1..20, Backlog.new(), &(&2 |> read(&1 * 600, 4_000, 2) |> elem(1)))
    assert starved.strained != nil
    for n <- 1..3, do: assert({1, _backlog} = read(starved, 20 * 600 + 1, 4_000, n))
  end

  test "what a link with a fifth of a processor keeps of 200 vehicles does not fall as they say more" do
    [least | _] = kept = [10, 20, 100] |> Enum.map(&starved/1) |> Enum.sort()
    assert least >= 0.8 * List.last(kept)
    assert least >= 12_000
  end

  # How many of `rate` datagrams a ms are kept in ten seconds of an overload. A read wakes the sessions of those of
  # whom it keeps something.
  defp starved(rate) do
    backlog = Enum.reduce(1..100, Backlog.new(), &(&2 |> read(&1 * 100, 200, 200, 200) |> elem(1)))
    play_starved({backlog, 10_001, 1_000, 0}, rate)
  end

  defp play_starved({_backlog, now, _waiting, kept}, _rate) when now > 23_000, do: kept

  defp play_starved({backlog, now, waiting, kept}, rate) do
    n = if Backlog.strained?(backlog), do: waiting, else: min(waiting, 128)
    {more, backlog} = read(backlog, now, waiting, n, 200)
    ms = ceil((n * 0.0055 + min(more, 200) * 0.17 + more * 0.043) / 0.2)
    # What the kernel has room for by default, as `Net` asks for it.
    room = min(Backlog.room(backlog), 5_041)
    waiting = max(min(waiting - n + ms * rate, room), waiting - n)
    kept = if now > 13_000, do: kept + more, else: kept
    play_starved({Backlog.passed(backlog, now + ms), now + ms, waiting, kept}, rate)
  end

  for {budget, strangers, least} <- [{40, 300, 0.7}, {160, 300, 0.98}, {250, 300, 0.98}, {400, 3_000, 0.98}] do
    test "a known vehicle keeps #{least} of 20 frames/s beside #{strangers} made-up senders, budget #{budget}" do
      heard =
        hear(40, unquote(budget), fn now ->
          # They come in the tenth second, all of them once a second.
          made_up =
            if now > 10_000,
              do: for(n <- 1..unquote(strangers), rem(now + n * 7, 1_000) == 0, do: {:made_up, n}),
              else: []

          every(now, 50, :known) ++ made_up
        end)

      # The last ones wait yet.
      assert share(heard, :known) >= unquote(least)
      assert heard.shed <= heard.sent.known * (1 - unquote(least))
      assert heard.shed_new > 1_000
    end
  end

  test "vehicles that were known alike share alike, and one that sends too much takes nothing from the others" do
    heard =
      hear(40, 300, fn now ->
        loud = if now > 10_000, do: List.duplicate(:loud, 2), else: every(now, 100, :loud)
        loud ++ every(now, 100, :one) ++ every(now, 50, :two)
      end)

    for sender <- [:one, :two], do: assert(share(heard, sender) >= 0.95)
    assert heard.shed > 10_000
  end

  test "the newest heartbeat of each sender is kept first, but of one that says nothing else no second one" do
    beat = fn sender, n -> {sender, <<0xFD, 9, 0, 0, n, 1, 1, 0::24, 0>>} end
    old = fn sender, n -> {sender, <<0xFE, 9, n, 1, 1, 0, 0>>} end
    other = fn sender, n -> {sender, <<0xFD, 9, 0, 0, n, 1, 1, 30::24-little, 0>>} end
    quiet = [beat.(:quiet, 1), old.(:old, 1), other.(:old, 2)]
    loud = for n <- 3..60, do: beat.(:loud, n)
    read = quiet ++ loud ++ for n <- 61..100, do: other.(:busy, n)
    backlog = %{Backlog.new() | measured: 0, began: 0, shed: 200, keep: {5, 101}}
    assert {kept, _discarded, _backlog} = Backlog.take(backlog, read)
    assert kept == [beat.(:quiet, 1), old.(:old, 1), beat.(:loud, 59), beat.(:loud, 60), other.(:busy, 100)]
  end

  test "systems behind one address are senders of their own" do
    frame = fn system -> {:router, <<0xFD, 9, 0, 0, 0, system, 1>>} end
    backlog = %{Backlog.new() | measured: 0}
    {_, _, backlog} = Backlog.take(backlog, [frame.(1)])
    flood = for(n <- 2..200, do: frame.(n)) ++ [{:router, <<0xFE, 9, 0, 1, 1>>}]
    backlog = %{backlog | measured: 20_000, began: 20_000, shed: 200, keep: {10, 200}}
    assert {read, %{shed: 0, shed_new: 190}, _backlog} = Backlog.take(backlog, flood)
    assert length(read) == 10 and List.last(read) == {:router, <<0xFE, 9, 0, 1, 1>>}
  end
end
