defmodule Aerie.Link.BacklogTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias Aerie.Link.Backlog

  # A link that reads `pace` datagrams a ms while `rate` a ms come, for some seconds: what was read after the
  # third, with its age, and what is left. Discarding costs a twentieth of reading.
  defp play(pace, rate, backlog_at_start, seconds \\ 3) do
    state = %{
      backlog: Backlog.new(),
      queue: :queue.from_list(List.duplicate(0, backlog_at_start)),
      ages: [],
      shed: 0
    }

    Enum.reduce(1..(seconds * 1000), state, fn now, state ->
      queue = :queue.join(state.queue, :queue.from_list(List.duplicate(now, rate)))

      backlog =
        if Backlog.due?(state.backlog, now),
          do: Backlog.measure(state.backlog, :queue.len(queue), now),
          else: state.backlog

      n = if backlog.shed > 0, do: pace * 20, else: pace
      {taken, rest} = :queue.split(min(n, :queue.len(queue)), queue)
      {read, shed, backlog} = Backlog.take(backlog, :queue.to_list(taken))
      ages = if now > 3_000, do: Enum.map(read, &(now - &1)) ++ state.ages, else: state.ages
      %{state | backlog: backlog, queue: rest, ages: ages, shed: state.shed + shed}
    end)
  end

  test "a link that keeps up discards nothing, whatever waited at first; nor does one that was held up for a moment" do
    for waiting <- [0, 10, 1_000], do: assert(play(10, 9, waiting).shed == 0)
    # Late for less than a second.
    assert play(5, 1, 5_000, 2).shed == 0
  end

  test "a link that does not keep up reads young datagrams, and discards only what was too much" do
    played = play(5, 10, 0, 6)
    assert Enum.max(played.ages) <= 700
    assert played.shed in 15_000..38_000
    assert :queue.len(played.queue) + played.shed + 5 * 6_000 >= 60_000
  end

  test "old datagrams are discarded, the oldest first" do
    played = play(5, 4, 20_000, 6)
    assert played.shed > 8_000
    assert Enum.max(played.ages) <= 700
  end

  test "every datagram is read or counted" do
    property =
      :proper.forall(list({range(0, 200), range(1, 100), range(0, 5_000)}), fn steps ->
        {_now, _backlog, same?} =
          Enum.reduce(steps, {0, Backlog.new(), true}, fn {n, ms, waiting}, {now, backlog, same?} ->
            now = now + ms
            backlog = if Backlog.due?(backlog, now), do: Backlog.measure(backlog, waiting, now), else: backlog
            datagrams = Enum.to_list(1..n//1)
            {read, shed, backlog} = Backlog.take(backlog, datagrams)
            {now, backlog, same? and Enum.drop(datagrams, shed) == read and backlog.shed >= 0}
          end)

        same?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
