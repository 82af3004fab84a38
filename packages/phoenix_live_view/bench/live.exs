# What one rendering of a table costs for one viewer: bin/bench live [TICKS]
#
# Each row has nine cells, of which about half change on each tick. A tick renders the template, compares it with what was sent
# last, and encodes the diff as JSON. "whole" is what a page costs that sends everything anew.
defmodule Bench.Table do
  use Phoenix.Component

  def page(assigns) do
    ~H"""
    <table>
      <tr :for={row <- @rows} id={"row-#{row.id}"} :key={row.id} class={["row", row.alarm && "alarm"]}>
        <td>{row.id}</td>
        <td :for={cell <- row.cells}>{cell}</td>
      </tr>
    </table>
    """
  end
end

alias Phoenix.LiveView.Diff

ticks =
  case System.argv() do
    [] -> 2_000
    [ticks] when ticks not in ["--help", "-h"] -> String.to_integer(ticks)
    _other -> IO.puts("usage: bin/bench live [TICKS]") && System.halt(0)
  end

:rand.seed(:exsss, {1, 2, 3})
cell = fn -> Float.to_string(:rand.uniform(100_000) / 100) end
start = fn count -> for id <- 1..count, do: %{id: id, alarm: false, cells: for(_ <- 1..8, do: cell.())} end

change = fn rows ->
  for row <- rows do
    cells = for old <- row.cells, do: if(:rand.uniform(2) == 1, do: cell.(), else: old)
    %{row | cells: cells, alarm: :rand.uniform(50) == 1}
  end
end

encode = fn wire -> IO.iodata_length(JSON.encode_to_iodata!([nil, nil, "lv:phx", "diff", wire])) end

figures = fn values ->
  sorted = Enum.sort(values)
  at = fn share -> Enum.at(sorted, min(trunc(length(sorted) * share), length(sorted) - 1)) end
  {at.(0.5), at.(0.99)}
end

ms = fn ns -> :erlang.float_to_binary(ns / 1.0e6, decimals: 3) end

IO.puts(
  "rows   diff ms (median, p99)   whole ms (median, p99)   bytes of a diff (median, p99)   bytes whole   kept kB"
)

for count <- [10, 50, 200] do
  rows = start.(count)
  render = fn rows -> Bench.Table.page(%{__changed__: nil, rows: rows}) end
  first = render.(rows)

  {measured, _state} =
    Enum.map_reduce(1..ticks, {rows, first}, fn _tick, {rows, sent} ->
      rows = change.(rows)
      begin = System.monotonic_time(:nanosecond)
      tree = render.(rows)
      bytes = sent |> Diff.diff(tree) |> encode.()
      between = System.monotonic_time(:nanosecond)
      whole = rows |> render.() |> Diff.root() |> encode.()
      over = System.monotonic_time(:nanosecond)
      {{between - begin, over - between, bytes, whole}, {rows, tree}}
    end)

  # The first ticks run code that is not loaded yet.
  measured = Enum.drop(measured, div(ticks, 10))
  {diff, diff99} = figures.(Enum.map(measured, &elem(&1, 0)))
  {whole, whole99} = figures.(Enum.map(measured, &elem(&1, 1)))
  {bytes, bytes99} = figures.(Enum.map(measured, &elem(&1, 2)))
  {all, _} = figures.(Enum.map(measured, &elem(&1, 3)))
  kept = div(:erts_debug.flat_size(first) * 8, 1_024)

  IO.puts(
    "#{String.pad_trailing("#{count}", 6)} #{String.pad_trailing("#{ms.(diff)}, #{ms.(diff99)}", 23)} " <>
      "#{String.pad_trailing("#{ms.(whole)}, #{ms.(whole99)}", 24)} #{String.pad_trailing("#{bytes}, #{bytes99}", 31)} " <>
      "#{String.pad_trailing("#{all}", 13)} #{kept}"
  )
end
