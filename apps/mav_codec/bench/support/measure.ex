defmodule MavCodec.Bench.Measure do
  @moduledoc """
  Times a function that handles many frames, and what it allocates.

  Each measurement runs in a process of its own. A *round* is one call; the time per frame of a round is its time divided
  by its frames. Reported are the best, the median and the 99th percentile over the rounds, garbage collection included, and
  the bytes of heap that one round takes, per frame. On a machine that does other things too, the best is nearest to what
  the code costs.
  """

  defstruct [:name, :frames, :best, :median, :p99, :memory]

  @doc "Measures `fun` for `milliseconds`, after a warm-up of a fifth of it. `frames` is what one call handles."
  def run(name, frames, fun, milliseconds \\ 1500) do
    {best, median, p99} = isolated(fn -> times(fun, frames, milliseconds) end, [])
    memory = isolated(fn -> memory(fun) / frames end, min_heap_size: 4_000_000)
    %__MODULE__{name: name, frames: frames, best: best, median: median, p99: p99, memory: memory}
  end

  @doc "A row measured elsewhere."
  def row(name, frames, {best, median, p99}),
    do: %__MODULE__{name: name, frames: frames, best: best, median: median, p99: p99}

  defp isolated(fun, options) do
    test = self()
    {pid, monitor} = :erlang.spawn_opt(fn -> send(test, {self(), fun.()}) end, [:monitor | options])

    receive do
      {^pid, result} ->
        Process.demonitor(monitor, [:flush])
        result

      {:DOWN, ^monitor, _, _, reason} ->
        exit(reason)
    end
  end

  defp times(fun, frames, milliseconds) do
    rounds(fun, deadline(div(milliseconds, 5)), [])
    sorted = fun |> rounds(deadline(milliseconds), []) |> Enum.sort()
    count = length(sorted)

    [best, median, p99] =
      for at <- [0, div(count, 2), min(count - 1, div(count * 99, 100))], do: Enum.at(sorted, at)

    {best / frames, median / frames, p99 / frames}
  end

  defp deadline(milliseconds), do: System.monotonic_time(:nanosecond) + milliseconds * 1_000_000

  defp rounds(fun, deadline, acc) do
    from = System.monotonic_time(:nanosecond)
    fun.()
    to = System.monotonic_time(:nanosecond)
    if to < deadline, do: rounds(fun, deadline, [to - from | acc]), else: [to - from | acc]
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

  @doc "The table of measurements as text."
  def table(rows) do
    header = ["", "best ns/frame", "median ns/frame", "p99 ns/frame", "frames/s (median)", "heap bytes/frame"]

    cells =
      for row <- rows,
          do: [
            row.name,
            number(row.best),
            number(row.median),
            number(row.p99),
            rate(row.median),
            memory_cell(row)
          ]

    widths =
      Enum.zip_with([header | cells], fn column -> column |> Enum.map(&String.length/1) |> Enum.max() end)

    Enum.map_join([header | cells], "\n", &line(&1, widths))
  end

  defp line([name | cells], [width | widths]) do
    cells = Enum.zip_with(cells, widths, &String.pad_leading/2)
    Enum.join([String.pad_trailing(name, width) | cells], "   ")
  end

  defp memory_cell(%{memory: nil}), do: "-"
  defp memory_cell(%{memory: memory}), do: number(memory)

  defp rate(nanoseconds), do: number(1.0e9 / nanoseconds)

  defp number(nil), do: "-"

  defp number(value) do
    value
    |> round()
    |> Integer.to_string()
    |> String.reverse()
    |> String.replace(~r/(\d{3})(?=\d)/, "\\1,")
    |> String.reverse()
  end
end
