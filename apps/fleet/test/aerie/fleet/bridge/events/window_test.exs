defmodule Aerie.Fleet.Bridge.Events.WindowTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Events.Window
  alias Aerie.Fleet.Bridge.Events.Outbox.Record

  defp item(vehicle, n),
    do: {{vehicle, n}, %Record{id: "#{vehicle}#{n}", vehicle: vehicle, subject: "s", body: ""}}

  defp send_all(window, now \\ 0, sent \\ []) do
    case Window.next(window, now) do
      {ref, {key, _record}, window} -> send_all(window, now, [{ref, key} | sent])
      :none -> {Enum.reverse(sent), window}
    end
  end

  test "one event of a vehicle at a time, vehicles side by side" do
    window = Window.put(Window.new(10), for(n <- 1..2, vehicle <- ["A", "B"], do: item(vehicle, n)))
    assert {[{a1, {"A", 1}}, {_b1, {"B", 1}}], window} = send_all(window)
    assert {{"A", 1}, window} = Window.confirm(window, a1)
    assert {[{_, {"A", 2}}], window} = send_all(window)
    assert {Window.in_flight(window), Window.size(window)} == {2, 3}
  end

  test "no more in flight than allowed" do
    window = Window.put(Window.new(3), for(n <- 1..9, do: item("V#{n}", 1)))
    assert {[{ref, _}, _, _], window} = send_all(window)
    {_, window} = Window.confirm(window, ref)
    assert {[_], _} = send_all(window)
  end

  test "what it has already is not taken twice, what was confirmed may come again" do
    window = Window.put(Window.new(3), [item("A", 1), item("A", 1)])
    assert Window.size(window) == 1
    {[{ref, _}], window} = send_all(window)
    {_, window} = Window.confirm(window, ref)
    refute Window.member?(window, {"A", 1})
    assert {[_], _} = window |> Window.put([item("A", 1)]) |> send_all()
  end

  test "an overdue event is sent again under a new number; a late answer to the old one is ignored" do
    window = Window.put(Window.new(3), [item("A", 1)])
    {[{old, _}], window} = send_all(window, 100)
    assert Window.overdue(window, 99) == []
    assert Window.overdue(window, 100) == [old]
    {new, {{"A", 1}, _}, 2, window} = Window.again(window, old, 200)
    assert Window.most_tries(window) == 2
    assert {nil, window} = Window.confirm(window, old)
    assert {{"A", 1}, window} = Window.confirm(window, new)
    assert Window.size(window) == 0
    assert Window.again(window, new, 300) == :none
  end

  test "after a reset an answer to what was sent before is not mistaken for one to what is sent now" do
    window = Window.put(Window.new(3), [item("A", 1)])
    {[{old, _}], window} = send_all(window)
    window = window |> Window.reset() |> Window.put([item("A", 2)])
    {[{new, {"A", 2}}], window} = send_all(window)
    assert new != old
    assert {nil, _} = Window.confirm(window, old)
  end

  # Whatever the order of puts, sends, answers, lost answers and resets: each vehicle's events are confirmed in order, each
  # once, and in the end all of them.
  test "any history keeps the order and loses nothing" do
    step =
      :proper_types.oneof([
        {:put, :proper_types.oneof(["A", "B", "C"])},
        :send,
        {:answer, :proper_types.integer(0, 10)},
        :overdue,
        :reset
      ])

    property =
      :proper.forall(:proper_types.list(step), fn steps ->
        start = %{window: Window.new(2), made: %{}, refs: [], confirmed: [], now: 0}
        state = steps |> Enum.reduce(start, &run/2) |> finish()

        Enum.all?(state.made, fn {vehicle, n} ->
          for({^vehicle, i} <- Enum.reverse(state.confirmed), do: i) == Enum.to_list(1..n)
        end) and Window.size(state.window) == 0
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  defp run({:put, vehicle}, state) do
    n = Map.get(state.made, vehicle, 0) + 1
    %{state | made: Map.put(state.made, vehicle, n), window: Window.put(state.window, [item(vehicle, n)])}
  end

  defp run(:send, state) do
    {sent, window} = send_all(state.window, state.now)
    %{state | window: window, refs: state.refs ++ Enum.map(sent, &elem(&1, 0)), now: state.now + 1}
  end

  defp run({:answer, _}, %{refs: []} = state), do: state

  defp run({:answer, n}, state) do
    {ref, refs} = List.pop_at(state.refs, rem(n, length(state.refs)))
    {key, window} = Window.confirm(state.window, ref)
    %{state | refs: refs, window: window, confirmed: List.wrap(key) ++ state.confirmed}
  end

  defp run(:overdue, state) do
    Enum.reduce(Window.overdue(state.window, state.now), state, fn ref, state ->
      {ref, _item, _tries, window} = Window.again(state.window, ref, state.now)
      %{state | window: window, refs: [ref | state.refs]}
    end)
  end

  # As after a lost connection: all that is not confirmed is put again, in order.
  defp run(:reset, state) do
    left =
      for {vehicle, n} <- state.made, i <- 1..n, {vehicle, i} not in state.confirmed, do: item(vehicle, i)

    %{state | window: state.window |> Window.reset() |> Window.put(left)}
  end

  defp finish(state) do
    state = run(:overdue, run(:send, state))

    if state.refs == [],
      do: state,
      else: finish(Enum.reduce(1..length(state.refs), state, fn _, s -> run({:answer, 0}, s) end))
  end
end
