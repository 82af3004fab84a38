defmodule Aerie.Console.Map.Tiles.QueueTest do
  use ExUnit.Case, async: true

  import :proper_types

  alias Aerie.Console.Map.Tiles.Fetcher.Queue

  @entry {:ok, %{body: "x"}}

  defp ask(queue, key, now, options \\ []) do
    server = Keyword.get(options, :server, "a")
    Queue.handle(queue, {:ask, key, server, {:asker, key, now}, key, now + 100}, now)
  end

  test "two at a time, the newest first, a question that is asked already once" do
    {queue, [{:start, 1, "a", 1}]} = ask(%Queue{}, 1, 0)
    {queue, [{:start, 2, "a", 2}]} = ask(queue, 2, 0)
    {queue, []} = ask(queue, 3, 0)
    {queue, []} = ask(queue, 4, 0)
    {queue, []} = ask(queue, 1, 1)
    {queue, [{:start, 9, "b", 9}]} = ask(queue, 9, 0, server: "b")
    {queue, actions} = Queue.handle(queue, {:done, 1, @entry}, 2)

    assert Enum.sort(actions) ==
             Enum.sort([
               {:reply, {:asker, 1, 0}, @entry},
               {:reply, {:asker, 1, 1}, @entry},
               {:start, 4, "a", 4}
             ])

    # Nobody waits for 3 any more.
    assert {%{waiting: [], jobs: jobs}, [{:reply, _asker, @entry}]} =
             Queue.handle(queue, {:done, 2, @entry}, 100)

    assert Map.keys(jobs) == [4, 9]
  end

  test "a server that fails is left alone for longer each time, and its questions are answered at once" do
    {queue, _start} = ask(%Queue{}, 1, 0)
    {queue, _start} = ask(queue, 2, 0)
    {queue, []} = ask(queue, 3, 0)
    {queue, actions} = Queue.handle(queue, {:done, 1, {:error, "no", nil}}, 10)
    assert {:failing, "a", "no"} in actions
    assert {:reply, {:asker, 3, 0}, {:error, "no"}} in actions
    assert {queue, [{:reply, {:asker, 4, 11}, {:error, "no"}}]} = ask(queue, 4, 11)
    # The other one, which was under way, fails as well: the wait is the second one.
    {queue, [{:reply, _asker, {:error, "no"}}]} = Queue.handle(queue, {:done, 2, {:error, "no", nil}}, 20)
    assert {queue, [{:reply, _asker, {:error, "no"}}]} = ask(queue, 5, 4_019)
    assert {queue, [{:start, 5, "a", 5}]} = ask(queue, 5, 4_020)

    assert {queue, [{:reply, _asker, _error}]} =
             Queue.handle(queue, {:done, 5, {:error, "wait", 3_600}}, 4_030)

    assert {queue, [{:reply, _asker, {:error, "wait"}}]} = ask(queue, 6, 3_604_029)
    assert {queue, [{:start, 6, "a", 6}]} = ask(queue, 6, 3_604_030)

    assert {queue, [{:reply, _asker, @entry}, {:working, "a"}]} =
             Queue.handle(queue, {:done, 6, @entry}, 3_604_040)

    assert %{failures: 0, errors: 3, fetched: 1, until: nil} = queue.servers["a"]
  end

  test "for any course: two a server at most, no question is answered twice, and nothing is left over" do
    event = oneof([{:ask, integer(1, 12), oneof(["a", "b"])}, {:done, boolean()}, {:pass, integer(0, 5_000)}])

    property =
      :proper.forall(list(event), fn events ->
        {queue, open, asked, answered, _now} = Enum.reduce(events, {%Queue{}, %{}, [], [], 0}, &run/2)
        # All that runs ends.
        {queue, _open, _asked, answered, _now} =
          Enum.reduce(1..60, {queue, open, asked, answered, 0}, fn _n, state -> run({:done, true}, state) end)

        answered == Enum.uniq(answered) and answered -- asked == [] and queue.jobs == %{} and
          queue.waiting == []
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  defp run({:pass, ms}, {queue, open, asked, answered, now}), do: {queue, open, asked, answered, now + ms}

  defp run({:ask, key, server}, {queue, open, asked, answered, now}) do
    asker = length(asked)
    event = {:ask, {server, key}, server, asker, key, now + 1_000_000}
    after_step(Queue.handle(queue, event, now), open, [asker | asked], answered, now)
  end

  defp run({:done, _ok?}, {_queue, open, _asked, _answered, _now} = state) when open == %{}, do: state

  defp run({:done, ok?}, {queue, open, asked, answered, now}) do
    [{key, server} | _] = Enum.sort(open)
    answer = if ok?, do: @entry, else: {:error, "no", nil}

    after_step(
      Queue.handle(queue, {:done, key, answer}, now),
      Map.delete(open, key),
      asked,
      answered,
      now,
      server
    )
  end

  defp after_step({queue, actions}, open, asked, answered, now, _server \\ nil) do
    open = for {:start, key, server, _work} <- actions, into: open, do: {key, server}
    answered = for({:reply, asker, _result} <- actions, do: asker) ++ answered
    true = open |> Map.values() |> Enum.frequencies() |> Map.values() |> Enum.all?(&(&1 <= 2))
    {queue, open, asked, answered, now}
  end
end
