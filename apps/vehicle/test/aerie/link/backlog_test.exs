defmodule Aerie.Link.BacklogTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias Aerie.Link.Backlog

  # A link that reads `pace` datagrams a ms while `rate` a ms come, for a second: what was read, with its age, and what
  # is left. Throwing away costs a twentieth of reading.
  defp play(pace, rate, backlog_at_start, seconds \\ 3) do
    state = %{
      backlog: Backlog.new(),
      queue: Enum.map(1..backlog_at_start//1, fn _ -> 0 end),
      ages: [],
      shed: 0
    }

    Enum.reduce(1..(seconds * 1000), state, fn now, state ->
      queue = state.queue ++ List.duplicate(now, rate)

      backlog =
        if Backlog.due?(state.backlog, now),
          do: Backlog.look(state.backlog, length(queue), now),
          else: state.backlog

      n = if backlog.shed > 0, do: pace * 20, else: pace
      {taken, rest} = Enum.split(queue, n)
      {read, shed, backlog} = Backlog.take(backlog, taken)
      ages = if now > 1000, do: Enum.map(read, &(now - &1)) ++ state.ages, else: state.ages
      %{state | backlog: backlog, queue: rest, ages: ages, shed: state.shed + shed}
    end)
  end

  test "who keeps up throws nothing away, whatever waited at first" do
    for waiting <- [0, 10, 1_000], do: assert(play(10, 9, waiting).shed == 0)
  end

  test "who does not keep up reads what is young, and what it throws away is what was too much" do
    played = play(5, 10, 0)
    assert Enum.max(played.ages) <= 700
    assert played.shed in 10_000..18_000
    assert length(played.queue) + played.shed + 5 * 3000 >= 30_000
  end

  test "what is old already goes, the oldest first" do
    played = play(5, 4, 10_000)
    assert played.shed > 5_000
    assert Enum.max(played.ages) <= 700
    assert play(5, 4, 10_000, 1).queue |> length() < 2_500
  end

  test "every datagram is read or counted" do
    property =
      :proper.forall(list({range(0, 200), range(1, 100), range(0, 5_000)}), fn steps ->
        {_now, _backlog, same?} =
          Enum.reduce(steps, {0, Backlog.new(), true}, fn {n, ms, waiting}, {now, backlog, same?} ->
            now = now + ms
            backlog = if Backlog.due?(backlog, now), do: Backlog.look(backlog, waiting, now), else: backlog
            datagrams = Enum.to_list(1..n//1)
            {read, shed, backlog} = Backlog.take(backlog, datagrams)
            {now, backlog, same? and Enum.drop(datagrams, shed) == read and backlog.shed >= 0}
          end)

        same?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true
  end
end
