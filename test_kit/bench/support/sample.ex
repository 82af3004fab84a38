defmodule Bench.Sample do
  @moduledoc "Times of calls, and what is said of many of them."

  @doc "The value that a share of all does not exceed, of sorted values; nil if there are none."
  def at([], _share), do: nil
  def at(sorted, share), do: Enum.at(sorted, max(ceil(length(sorted) * share) - 1, 0))

  @doc "The values at shares: median, 99th percentile and largest unless given; nil if there are none."
  def spread(values, shares \\ [0.5, 0.99, 1.0])
  def spread([], _shares), do: nil
  def spread(values, shares), do: with(sorted = Enum.sort(values), do: Enum.map(shares, &at(sorted, &1)))

  @doc "The median."
  def median(values), do: values |> Enum.sort() |> Enum.at(div(length(values), 2))

  @doc "A number with so many decimals."
  def round(number, decimals \\ 1), do: Float.round(number * 1.0, decimals)

  @doc "How long each call takes, in ns; `fun` gets an item and what the call before has given."
  def calls(items, fun) do
    {times, _last} =
      Enum.map_reduce(items, nil, fn item, state ->
        start = System.monotonic_time(:nanosecond)
        state = fun.(item, state)
        {System.monotonic_time(:nanosecond) - start, state}
      end)

    times
  end

  @doc "Microseconds and reductions of `fun`, and its result."
  def cost(fun) do
    {:reductions, before} = Process.info(self(), :reductions)
    {us, result} = :timer.tc(fun)
    {:reductions, now} = Process.info(self(), :reductions)
    {us, now - before, result}
  end

  @doc "Milliseconds that `fun` takes."
  def ms(fun), do: elem(:timer.tc(fun), 0) / 1000

  @doc "CPU seconds of this OS process."
  def cpu, do: elem(:erlang.statistics(:runtime), 0) / 1000

  @doc "Waits until `fun` gives neither nil nor false; gives that."
  def until(fun, poll_ms \\ 5) do
    with value when value in [nil, false] <- fun.() do
      Process.sleep(poll_ms)
      until(fun, poll_ms)
    end
  end

  @doc "Waits for a moment of the monotonic clock (us)."
  def sleep_until(due) do
    left = due - System.monotonic_time(:microsecond)
    if left > 0, do: Process.sleep(div(left + 999, 1000))
  end
end
