defmodule MavRouter.Link.BacklogTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias MavRouter.Link.Backlog

  # A link that reads `pace` datagrams a ms while `rate` a ms come from one sender, beside those that wait at first.
  defp play(pace, rate, backlog_at_start, seconds \\ 3) do
    hear(seconds, pace * 1_000, fn now ->
      List.duplicate(:one, if(now == 1, do: rate + backlog_at_start, else: rate))
    end)
  end

  # A link that reads `budget` datagrams in a second, while `send` says who sends in each ms, for so many seconds: what each sender
  # sent, what was read of it, how old what was read after three seconds was, and what is left. Reads are of at most 128 datagrams,
  # which it cannot leave half done, and discarding costs a twentieth of reading.
  defp hear(seconds, budget, send) do
    state = %{
      backlog: Backlog.new(),
      queue: :queue.new(),
      credit: 0,
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
      spend(%{state | queue: queue, sent: sent, credit: min(state.credit, 20_000) + budget}, now)
    end)
  end

  defp spend(%{credit: credit} = state, now) do
    n = min(128, :queue.len(state.queue))

    if n == 0 or credit < 1_000 do
      state
    else
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

  for {budget, strangers, least} <- [{40, 300, 0.7}, {160, 300, 0.98}, {250, 300, 0.98}, {400, 3_000, 0.98}] do
    test "a known vehicle with 20 frames a second keeps #{least} of them beside #{strangers} made-up senders, with a budget of #{budget}" do
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
