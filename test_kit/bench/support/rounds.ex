defmodule Bench.Rounds do
  @moduledoc """
  Times a function that handles many frames, and what it allocates.

  Each measurement runs in a process of its own. A *round* is one call; the time per frame of a round is its time
  divided by its frames. Reported are the best, the median and the 99th percentile over the rounds, garbage collection
  included, and the bytes of heap that one round takes, per frame. On a machine that does other things as well, the
  best is nearest to what the code costs.
  """

  @widths [42, -15, -18, -15, -20, -19]

  @doc "Measures `fun` for `milliseconds`, after a warm-up of a fifth of it. `frames` is what one call handles."
  def run(name, frames, fun, milliseconds) do
    times = isolated([], fn -> times(fun, milliseconds) end)
    memory = isolated([min_heap_size: 4_000_000], fn -> memory(fun) / frames end)
    times |> Bench.Sample.spread([0.0, 0.5, 0.99]) |> Enum.map(&(&1 / frames)) |> row(name, memory)
  end

  @doc "A row of best, median and 99th percentile that were measured elsewhere."
  def row([best, median, p99], name, memory \\ nil),
    do: %{name: name, best: best, median: median, p99: p99, memory: memory}

  defp isolated(options, fun) do
    caller = self()
    {pid, monitor} = :erlang.spawn_opt(fn -> send(caller, {self(), fun.()}) end, [:monitor | options])

    receive do
      {^pid, result} -> Process.demonitor(monitor, [:flush]) && result
      {:DOWN, ^monitor, _, _, reason} -> exit(reason)
    end
  end

  defp times(fun, milliseconds) do
    rounds(fun, deadline(div(milliseconds, 5)), [])
    rounds(fun, deadline(milliseconds), [])
  end

  defp deadline(milliseconds), do: System.monotonic_time(:nanosecond) + milliseconds * 1_000_000

  defp rounds(fun, deadline, times) do
    from = System.monotonic_time(:nanosecond)
    fun.()
    to = System.monotonic_time(:nanosecond)
    if to < deadline, do: rounds(fun, deadline, [to - from | times]), else: [to - from | times]
  end

  # What one round allocates is garbage after it, and the runtime counts the words that it reclaims.
  defp memory(fun) do
    fun.()
    :erlang.garbage_collect()
    before = reclaimed()
    fun.()
    :erlang.garbage_collect()
    (reclaimed() - before) * :erlang.system_info(:wordsize)
  end

  defp reclaimed, do: elem(:erlang.statistics(:garbage_collection), 1)

  @doc "Prints the table of measurements."
  def table(rows) do
    header = ["", "best ns/frame", "median ns/frame", "p99 ns/frame", "frames/s (median)", "heap bytes/frame"]
    Bench.Table.columns(header, @widths)

    for row <- rows do
      numbers = [row.best, row.median, row.p99, 1.0e9 / row.median, row.memory]
      Bench.Table.columns([row.name | Enum.map(numbers, &number/1)], @widths)
    end
  end

  defp number(nil), do: "-"
  defp number(value), do: value |> round() |> Integer.to_string() |> String.replace(~r/\B(?=(\d{3})+$)/, ",")
end
